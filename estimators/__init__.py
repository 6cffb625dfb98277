"""State estimators behind one batched contract, on NumPy and SciPy, compiled at first use.

The last axis holds the components of a vector, every leading axis is a batch::

    from estimators import Gaussian, LinearModel, make

    model = LinearModel(A, C, Q, R)
    kf = make("kf", model)
    belief = kf.init(Gaussian(mean, cov))
    belief = kf.update(kf.predict(belief, u), y)
    belief.mean, belief.cov
"""

from estimators.angles import wrap
from estimators.augmentation import stacked
from estimators.belief import (
    Belief,
    DelayedInputBelief,
    EnsembleBelief,
    FeedthroughBelief,
    InputBelief,
    ObservedInputBelief,
)
from estimators.check import check_filter
from estimators.delayed import Delayed, DelayedBelief
from estimators.discretisation import sampled, van_loan, zero_order_hold
from estimators.engine import compiled
from estimators.ensemble import (
    EnsembleFilter,
    EnsembleKalmanFilter,
    EnsembleTransformFilter,
)
from estimators.factory import make, names
from estimators.faults import ChiSquareMonitor, CusumMonitor, FaultMonitor, MonitorState
from estimators.filter import Filter, Model, Rng
from estimators.input_observability import InputConditions, input_conditions
from estimators.iterated import IteratedExtendedKalmanFilter
from estimators.kalman import ExtendedKalmanFilter, KalmanFilter
from estimators.metrics import chi_square_band, nees, nis, rmse
from estimators.models import Gaussian, LinearModel, NonlinearModel
from estimators.particles import ParticleBelief, ParticleFilter
from estimators.randomness import RandomKeys
from estimators.robust import HuberKalmanFilter, RobustKalmanFilter
from estimators.series import Series, run
from estimators.smoothers import smooth
from estimators.tuning import Fit, fit
from estimators.ulise import ULISE
from estimators.unknown_input import (
    DelayedInputFilter,
    DelayedUMVFilter,
    EndedUMVFilter,
    ExtendedUMVFilter,
    NoFeedthroughFilter,
    UMVFilter,
    UnknownInputFilter,
)
from estimators.unscented import SigmaPoints, UnscentedKalmanFilter, UnscentedUMVFilter
from estimators.varying import Schedule, StateNoise

__all__ = [
    "ULISE",
    "Belief",
    "ChiSquareMonitor",
    "CusumMonitor",
    "Delayed",
    "DelayedBelief",
    "DelayedInputBelief",
    "DelayedInputFilter",
    "DelayedUMVFilter",
    "EndedUMVFilter",
    "EnsembleBelief",
    "EnsembleFilter",
    "EnsembleKalmanFilter",
    "EnsembleTransformFilter",
    "ExtendedKalmanFilter",
    "ExtendedUMVFilter",
    "FaultMonitor",
    "FeedthroughBelief",
    "Filter",
    "Fit",
    "Gaussian",
    "HuberKalmanFilter",
    "InputBelief",
    "InputConditions",
    "IteratedExtendedKalmanFilter",
    "KalmanFilter",
    "LinearModel",
    "Model",
    "MonitorState",
    "NoFeedthroughFilter",
    "NonlinearModel",
    "ObservedInputBelief",
    "ParticleBelief",
    "ParticleFilter",
    "RandomKeys",
    "Rng",
    "RobustKalmanFilter",
    "Schedule",
    "Series",
    "SigmaPoints",
    "StateNoise",
    "UMVFilter",
    "UnknownInputFilter",
    "UnscentedKalmanFilter",
    "UnscentedUMVFilter",
    "check_filter",
    "chi_square_band",
    "compiled",
    "fit",
    "input_conditions",
    "make",
    "names",
    "nees",
    "nis",
    "rmse",
    "run",
    "sampled",
    "smooth",
    "stacked",
    "van_loan",
    "wrap",
    "zero_order_hold",
]
