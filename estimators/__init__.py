"""State estimators behind one batched contract: NumPy and SciPy only.

The last axis holds the components of a vector, every leading axis is a batch::

    from estimators import Gaussian, LinearModel, make

    model = LinearModel(A, C, Q, R)
    kf = make("kf", model)
    belief = kf.init(Gaussian(mean, cov))
    belief = kf.update(kf.predict(belief, u), y)
    belief.mean, belief.cov
"""

from estimators.angles import wrap
from estimators.belief import Belief, Recovery
from estimators.ensemble import EnsembleKalmanFilter, EnsembleSquareRootFilter, EnsembleTransformFilter
from estimators.factory import make, names
from estimators.filter import Filter
from estimators.kalman import ExtendedKalmanFilter, KalmanFilter
from estimators.metrics import chi_square_band, nees, nis, rmse
from estimators.models import Gaussian, LinearModel, NonlinearModel, forward_euler, van_loan, zero_order_hold
from estimators.robust import HuberKalmanFilter, RobustKalmanFilter
from estimators.ulise import UnifiedInputStateEstimator
from estimators.unknown_input import (
    ExtendedUnbiasedMinimumVarianceFilterWithoutFeedthrough,
    UnbiasedMinimumVarianceFilter,
    UnbiasedMinimumVarianceFilterWithoutFeedthrough,
)
from estimators.unscented import UnscentedKalmanFilter, UnscentedUnbiasedMinimumVarianceFilter

__all__ = [
    "Belief",
    "EnsembleKalmanFilter",
    "EnsembleSquareRootFilter",
    "EnsembleTransformFilter",
    "ExtendedKalmanFilter",
    "ExtendedUnbiasedMinimumVarianceFilterWithoutFeedthrough",
    "Filter",
    "Gaussian",
    "HuberKalmanFilter",
    "KalmanFilter",
    "LinearModel",
    "NonlinearModel",
    "Recovery",
    "RobustKalmanFilter",
    "UnbiasedMinimumVarianceFilter",
    "UnbiasedMinimumVarianceFilterWithoutFeedthrough",
    "UnifiedInputStateEstimator",
    "UnscentedKalmanFilter",
    "UnscentedUnbiasedMinimumVarianceFilter",
    "chi_square_band",
    "forward_euler",
    "make",
    "names",
    "nees",
    "nis",
    "rmse",
    "van_loan",
    "wrap",
    "zero_order_hold",
]
