"""The filter that a beginner writes first: the README's own example, for the corvette's study."""

from typing import Any

import numpy as np

from estimators import Filter


class FixedGain(Filter):
    """Each innovation moves the states that its sensor reads by a tenth of it."""

    name = "fixed-gain"

    def _predict(self, belief: Any, u: Any, mean: Any, A: Any, Q: Any) -> Any:
        return {"mean": mean}

    def _update(self, belief: Any, u: Any, e: Any, C: Any, R: Any, available: Any) -> Any:
        return {"mean": belief.mean + 0.1 * np.matvec(C.mT, e)}
