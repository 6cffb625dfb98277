"""State estimators behind one batched contract: NumPy and SciPy; Numba compiles what they do when it is first done.

The last axis holds the components of a vector, every leading axis is a batch::

    from estimators import Gaussian, LinearModel, make

    model = LinearModel(A, C, Q, R)
    kf = make("kf", model)
    belief = kf.init(Gaussian(mean, cov))
    belief = kf.update(kf.predict(belief, u), y)
    belief.mean, belief.cov
"""

from estimators.angles import wrap
from estimators.belief import Belief, DelayedInputBelief, EnsembleBelief, FeedthroughBelief, InputBelief, Recovery
from estimators.ensemble import (
    DrawingFilter,
    EnsembleFilter,
    EnsembleKalmanFilter,
    EnsembleSquareRootFilter,
    EnsembleTransformFilter,
    LocalEnsembleTransformFilter,
    gaspari_cohn,
)
from estimators.factory import make, names
from estimators.filter import Filter, Model, Rng
from estimators.kalman import ExtendedKalmanFilter, GaussianFilter, KalmanFilter
from estimators.learned import GainNetwork, LearnedGainBelief, LearnedGainFilter
from estimators.metrics import chi_square_band, nees, nis, rmse
from estimators.models import (
    Gaussian,
    LinearModel,
    NonlinearModel,
    Schedule,
    forward_euler,
    retimed,
    stacked,
    van_loan,
    zero_order_hold,
)
from estimators.particles import ParticleBelief, ParticleFilter
from estimators.randomness import Numbers
from estimators.reading import Reading
from estimators.robust import HuberKalmanFilter, RobustKalmanFilter
from estimators.ulise import ULISE
from estimators.unknown_input import (
    DelayedInputFilter,
    DelayedUMVFilter,
    ExtendedUMVFilter,
    InputConditions,
    NoFeedthroughFilter,
    UMVFilter,
    UnknownInputFilter,
    input_conditions,
)
from estimators.unscented import SigmaPoints, UnscentedKalmanFilter, UnscentedUMVFilter

__all__ = [
    "ULISE",
    "Belief",
    "DelayedInputBelief",
    "DelayedInputFilter",
    "DelayedUMVFilter",
    "DrawingFilter",
    "EnsembleBelief",
    "EnsembleFilter",
    "EnsembleKalmanFilter",
    "EnsembleSquareRootFilter",
    "EnsembleTransformFilter",
    "ExtendedKalmanFilter",
    "ExtendedUMVFilter",
    "FeedthroughBelief",
    "Filter",
    "GainNetwork",
    "Gaussian",
    "GaussianFilter",
    "HuberKalmanFilter",
    "InputBelief",
    "InputConditions",
    "KalmanFilter",
    "LearnedGainBelief",
    "LearnedGainFilter",
    "LinearModel",
    "LocalEnsembleTransformFilter",
    "Model",
    "NoFeedthroughFilter",
    "NonlinearModel",
    "Numbers",
    "ParticleBelief",
    "ParticleFilter",
    "Reading",
    "Recovery",
    "Rng",
    "RobustKalmanFilter",
    "Schedule",
    "SigmaPoints",
    "UMVFilter",
    "UnknownInputFilter",
    "UnscentedKalmanFilter",
    "UnscentedUMVFilter",
    "chi_square_band",
    "forward_euler",
    "gaspari_cohn",
    "input_conditions",
    "make",
    "names",
    "nees",
    "nis",
    "retimed",
    "rmse",
    "stacked",
    "van_loan",
    "wrap",
    "zero_order_hold",
]
