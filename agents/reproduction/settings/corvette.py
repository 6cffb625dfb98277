"""Hermawan's thesis (2020), KF-UMV-UI on a SIGMA corvette: what chapter IV prints, and what it leaves open."""

from dataclasses import dataclass

from agents.reproduction.comparison import Published

SAMPLES = 195  # Section 4.5
SMALL, LARGE = 1e-3, 1.0  # the two variances on the diagonals of Q and R, eq. 4.6 and Section 4.5


@dataclass(frozen=True)
class Simulation:
    """One of the thesis' five simulations.

    Attributes:
        Q: Process noise variance that the filter is told, times identity.
        R: Measurement noise variance that it is told, times identity.
        size: Of the unknown input d [rad].
        where: The table of its runs.
        heading: Printed RMSE of x_3 [rad] in runs I, II, III.
        unknown_input: Printed RMSE of d in the same runs.
        mean_heading: Their mean as Table 4.9 prints it.
        mean_unknown_input: Likewise.
    """

    Q: float
    R: float
    size: float
    where: str
    heading: tuple[str, ...]
    unknown_input: tuple[str, ...]
    mean_heading: str
    mean_unknown_input: str

    def published(self, quantity: str) -> dict[str, Published]:
        """The printed numbers of "heading" or "unknown input", by column."""
        runs, mean = {
            "heading": (self.heading, self.mean_heading),
            "unknown input": (self.unknown_input, self.mean_unknown_input),
        }[quantity]
        columns = {f"run {name}": Published(value, "rad", self.where) for name, value in zip(RUNS, runs, strict=True)}
        return columns | {"mean": Published(mean, "rad", "Table 4.9")}


RUNS = ("I", "II", "III")
QUANTITIES = ("heading", "unknown input")
SIZE = 0.01  # rad, of d in I to IV
LARGER_SIZE = 0.1  # rad, of d in V, as printed

_PRINTED = {  # heading and d in runs I, II, III, then the means of both
    "I": (SMALL, SMALL, SIZE, "0.0047 0.0046 0.0048  0.0006 0.0006 0.0006  0.0047 0.0006"),
    "II": (LARGE, SMALL, SIZE, "0.0048 0.0049 0.0047  0.0006 0.0006 0.0006  0.0048 0.0006"),
    "III": (SMALL, LARGE, SIZE, "0.0095 0.0053 0.0057  0.0063 0.0028 0.0026  0.0068 0.0039"),
    "IV": (LARGE, LARGE, SIZE, "0.0087 0.0071 0.0067  0.0057 0.0039 0.0053  0.0075 0.0050"),
    "V": (SMALL, SMALL, LARGER_SIZE, "0.0370 0.0370 0.0370  0.0057 0.0057 0.0057  0.0370 0.0057"),
}
SIMULATIONS = {
    name: Simulation(Q, R, size, f"Table 4.{table}", tuple(row[:3]), tuple(row[3:6]), *row[6:])
    for table, (name, (Q, R, size, text)) in enumerate(_PRINTED.items(), 4)
    for row in [text.split()]
}

# --- what the thesis leaves open: reasons stand in pages/corvette.md ----------------------------------

NOISE = 6e-4  # rad
PRIOR = SMALL  # variance, times identity
WIDE_PRIOR = LARGE
STEP = 0.8  # s
HELM = 28.0  # deg
SWITCH = 98
"""Sample from which d is down."""
