"""The filter that a beginner writes first: the README's own example, for the corvette's study."""

from typing import Any

import numpy as np

from estimators import Filter


class FixedGain(Filter):
    """Each innovation moves the states that its sensor reads by a tenth of it."""

    name = "fixed-gain"

    def _predict(self, belief: Any, u: Any, rng: Any) -> Any:
        return belief.replace(mean=self.model.transition(belief.mean, u), u=u)

    def _update(self, belief: Any, measurement: Any, rng: Any) -> Any:
        return belief.replace(
            mean=belief.mean + 0.1 * np.matvec(measurement.C.mT, measurement.innovation)
        )
