"""Hermawan's thesis (2020), KF-UMV-UI on a SIGMA corvette: what chapter IV prints, and what it leaves open."""

from dataclasses import dataclass

from agents.reproduction.comparison import Published

PAPER = (
    "A. E. Hermawan, “Estimasi model kapal perang korvet kelas SIGMA menggunakan metode KF-UMV-UI”, "
    "final project KM184801, Institut Teknologi Sepuluh Nopember, Surabaya, 2020"
)
SAMPLES = 195  # Section 4.5
PRINTED_STEP = 0.5  # s, Section 4.2
PRINTED_RUDDER = 35.0  # deg, Section 4.3.1
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
    heading: tuple[str, str, str]
    unknown_input: tuple[str, str, str]
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

SIMULATIONS = {
    "I": Simulation(
        SMALL, SMALL, SIZE, "Table 4.4", ("0.0047", "0.0046", "0.0048"), ("0.0006", "0.0006", "0.0006"),
        "0.0047", "0.0006",
    ),
    "II": Simulation(
        LARGE, SMALL, SIZE, "Table 4.5", ("0.0048", "0.0049", "0.0047"), ("0.0006", "0.0006", "0.0006"),
        "0.0048", "0.0006",
    ),
    "III": Simulation(
        SMALL, LARGE, SIZE, "Table 4.6", ("0.0095", "0.0053", "0.0057"), ("0.0063", "0.0028", "0.0026"),
        "0.0068", "0.0039",
    ),
    "IV": Simulation(
        LARGE, LARGE, SIZE, "Table 4.7", ("0.0087", "0.0071", "0.0067"), ("0.0057", "0.0039", "0.0053"),
        "0.0075", "0.0050",
    ),
    "V": Simulation(
        SMALL, SMALL, LARGER_SIZE, "Table 4.8", ("0.0370", "0.0370", "0.0370"), ("0.0057", "0.0057", "0.0057"),
        "0.0370", "0.0057",
    ),
}  # fmt: skip

# --- what the thesis leaves open --------------------------------------------------------------------

NOISE = 6e-4  # rad
NOISE_REASON = (
    "Standard deviation of both readings, the same for every cell of the table. The thesis states R for the filter "
    "and not what was simulated. The filter of II, its Q a thousand times its R, takes the difference of the readings "
    "for the heading, so that the second reading is its d: the error of d is σ, and it is printed as 0.0006. That "
    "number is therefore no test of ours. The other way to read R, as the variance of the noise that was simulated, is "
    "computed beside it."
)
PRIOR = SMALL  # variance, times identity
WIDE_PRIOR = LARGE
PRIOR_REASON = (
    "The thesis prints the initial state (zero, Table 4.3) but no covariance; 10⁻³ is what eq. 4.6 starts Q at. "
    f"{WIDE_PRIOR:g} is computed beside it."
)
STEP = 0.8  # s
HELM = 28.0  # deg
RECORD_REASON = (
    f"The trial record is not public. Ours is this package's nonlinear ship, its helm put to {HELM:g}° from 15.4 m/s "
    f"straight ahead. At the printed {PRINTED_STEP:g} s a ship of this size cannot turn through the 0 to 360° of the "
    f"thesis' record in {SAMPLES} samples; at {STEP:g} s it does, and stays within the 0 to 7 rad of its figures. "
    "What the printed filter meets is the turn per sample, 0.033 rad here and 0.032 rad in the thesis, if its "
    f"record is one turn. The printed rudder is {PRINTED_RUDDER:g}°; beyond {HELM:g}° the ship turns hardly faster "
    "and the corrected linear model is not made for it. The printed model does not notice: in it the rudder changes "
    f"the yaw rate by about 10⁻⁷ rad/s a step. Its matrices keep their {PRINTED_STEP:g} s."
)
SWITCH = 98
"""Sample from which d is down."""
INPUT_REASON = (
    "Printed are 1 u_s[k] − 2 u_s[k − 1] for I to IV and 0.1 u_s[k] − 0.2 u_s[k − 0.1] for V, which the text calls "
    "larger: so I to IV cannot be of size 1. We take 0.01, a tenth of V, as the errors of V are eight to ten times "
    "those of I. The unit of k is not printed (a delay of 0.1 samples is none), only that d steps up, then down; "
    "ours is up until the middle, so that the filter has settled when the step comes. Read as samples, d would be "
    "up for the first one only: computed beside it."
)
TRUTH_REASON = (
    "The real heading is a record made at sea, before d was invented: d can be in the readings (H d, eq. 4.5) but "
    "not in the heading, although the filter believes that it is (G d, eq. 4.4). A heading that d does drive, as "
    "eq. 4.4 has it, is computed beside it; with the d of V the ship would turn a further 10 rad."
)
MISPRINTS = [
    "d is 1 u_s[k] − 2 u_s[k − 1] below eq. 4.4 and 0.1 u_s[k] − 0.2 u_s[k − 0.1] in V, which is called the larger.",
    "The text of simulation II says 0.0047 for the heading, the same as I; its runs and Table 4.9 say 0.0048.",
    "Tables 4.7 and 4.8 are titled “Simulasi Numerik I”; they hold simulations IV and V.",
    "The text refers to eqs. 4.6 and 4.7 for d and for Q and R; d has no number, and Q and R are eq. 4.6.",
    "Eq. 4.3: the first row lacks the identity of x + Δt ẋ, A = −M⁻¹N lost its minus in eq. 4.2, and a "
    "non-dimensional A (unit of time L/U = 6.6 s) is stepped by 0.5 s.",
    "Table 2.5 and Section 4.4.2 name the matrix of d E, C and B in turn, B being that of the rudder, and print a "
    "covariance step whose shapes do not fit. We use the filter of Gillijns and De Moor (2007), which it cites.",
]
