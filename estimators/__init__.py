"""State estimators behind one batched contract, on NumPy and SciPy, compiled at first use.

The last axis holds the components of a vector, every leading axis is a batch::

    from estimators import Gaussian, LinearModel, make

    model = LinearModel(A, C, Q, R)
    kf = make("kf", model)
    belief = kf.init(Gaussian(mean, cov))
    belief = kf.update(kf.predict(belief, u), y)
    belief.mean, belief.cov

This package imports neither `vessel_gym` nor `agents`; its compiler is `estimators.engine`.
"""

from estimators.lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__)
