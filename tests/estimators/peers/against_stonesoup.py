"""Stone Soup: its Kalman filter and smoother, and the measurement noise of its ensembles."""

# /// script
# dependencies = ["stonesoup==1.9.1", "llvmlite==0.50.0", "numpy==2.4.6", "scipy==1.17.1"]
# ///

from datetime import datetime, timedelta

import numpy as np
from case import COV, MEAN, Y, close, prior
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.smoother.kalman import KalmanSmoother
from stonesoup.types.array import StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.prediction import EnsembleStatePrediction
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.ensemble import EnsembleSqrtUpdater, EnsembleUpdater
from stonesoup.updater.kalman import KalmanUpdater

from estimators import make, run, sampled, smooth

# steps of several lengths
start, t = datetime(2026, 1, 1), np.array([0.0, 0.3, 1.0, 1.1, 2.5])
predictor = KalmanPredictor(ConstantVelocity(0.2))
updater = KalmanUpdater(LinearGaussian(2, [0], np.array([[0.5]])))
state, track = GaussianState(MEAN[:, None], COV, timestamp=start), Track()
for now, y in zip(t, Y, strict=False):
    time = start + timedelta(seconds=now)
    state = predictor.predict(state, timestamp=time)
    state = updater.update(SingleHypothesis(state, Detection([[y[0]]], timestamp=time)))
    track.append(state)
model = sampled([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], np.diag([0.0, 0.2]), [[0.5]])
ours = run(make("kf", model), prior, Y[:5, :1], t=t)
close([each.state_vector for each in track], ours.mean)
smoothed = KalmanSmoother(predictor.transition_model).smooth(track)
close([each.state_vector for each in smoothed], smooth(ours).mean)

# a prior of N(0, 1), y = 1 and R = 1: right is N(.5, .5)
np.random.seed(0)  # noqa: NPY002  Stone Soup draws from the global stream
members = np.random.normal(size=(1, 1_000))  # noqa: NPY002
members = (members - members.mean()) / members.std(ddof=1)
measurement = LinearGaussian(1, [0], np.eye(1))
found = {}
for cls in EnsembleUpdater, EnsembleSqrtUpdater:
    for noise in True, False:
        updater, draws = cls(measurement), []
        prediction = EnsembleStatePrediction(StateVectors(members), timestamp=start)
        expected = updater.predict_measurement(prediction, measurement_noise=noise)
        seen = Detection([[1.0]], timestamp=start)
        for _ in range(20):
            after = updater.update(SingleHypothesis(prediction, seen, expected)).state_vector
            draws.append(np.asarray(getattr(after, "state_vector", after), float))
        found[cls.__name__, noise] = np.mean(draws), np.var(draws)
print(found)
close(found["EnsembleUpdater", True], [0.5, 0.75], 0.05)
close(found["EnsembleSqrtUpdater", True], [1 / 3, 2 / 3], 0.05)
close(found["EnsembleUpdater", False], [0.5, 0.5], 0.05)
close(found["EnsembleSqrtUpdater", False], [0.5, 0.5], 0.05)
