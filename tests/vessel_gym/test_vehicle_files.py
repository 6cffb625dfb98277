"""Vehicle files: those of the package, what may be given, and what is wrong, in one sentence with its line."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vessel_gym.vehicles.files as files
from vessel_gym.vehicles.auv import AUVParameters
from vessel_gym.vehicles.corvette import steady_turns
from vessel_gym.vehicles.corvette_equations import COEFFICIENTS, CorvetteParameters
from vessel_gym.vehicles.files import load, names
from vessel_gym.vehicles.hydrodynamics import Coefficients
from vessel_gym.vehicles.itsunusa import ItsunusaParameters
from vessel_gym.vehicles.puna import trim
from vessel_gym.vehicles.segorogeni import SegorogeniParameters

DATA = Path(files.__file__).with_name("data")

SHIP = """\
kind = "ship"

[particulars]
length = 60.0  # m
beam = 10.0
draught = 3.0
mass = 0.9e6

[rudder]
rudder_area = 5.0
rudder_limit_deg = 30

[propulsion]
speed = 7.0
resistance = 6e4
"""

TORPEDO = """\
kind = "auv"

[particulars]
length = 1.5
diameter = 0.2
z_g = 0.02

[fins]
fin_area = 0.01
fin_position = -0.7

[propulsion]
cruise_speed = 1.5
thrust_limit = 15.0
"""

WING = """\
kind = "fixed-wing"

[particulars]
mass = 3.0
area = 0.7

[aerodynamics]
lift = [4.0, 0.1]
drag = [1.0, 0.1, 0.02]

[propulsion]
cruise_speed = 18.0
thrust_limit = 15.0
"""


THRUSTERS = """\
kind = "rov"

[particulars]
mass = 10.0
roll_inertia = 0.2
pitch_inertia = 0.2
yaw_inertia = 0.3
z_g = 0.02

[thrusters]
positions = [[0.1, 0.2, 0.0], [0.1, -0.2, 0.0]]
directions = [[1, 0, 0], [1, 0, 0]]
thrust_limit = 20.0

[coefficients]
X_udot = -5.0
Y_vdot = -6.0
Z_wdot = -7.0
K_pdot = -0.1
M_qdot = -0.1
N_rdot = -0.1
X_uu = -50.0
Y_vv = -60.0
Z_ww = -70.0
K_pp = -1.0
M_qq = -1.0
N_rr = -1.0
"""


@pytest.fixture
def write(tmp_path, monkeypatch):
    """A function that writes ``my.toml`` into the working directory."""
    monkeypatch.chdir(tmp_path)
    return lambda text: Path("my.toml").write_text(text, encoding="utf-8") and "my.toml"


def complaint(source: str, *wanted) -> str:
    with pytest.raises(ValueError) as caught:  # noqa: PT011  its text is what is asked for
        load(source, *wanted)
    return str(caught.value)


# --- the vehicles of the package ------------------------------------------------------------------


@pytest.mark.parametrize("name", names())
def test_every_number_of_a_vehicle_names_its_source(name: str):
    text = (DATA / f"{name}.toml").read_text(encoding="utf-8")
    numbers = [line for line in text.splitlines() if re.match(r"[A-Za-z_]+ = [-\[0-9]", line)]
    assert len(numbers) > 8
    for line in numbers:
        assert re.search(r"#.*[A-Za-z]{4}", line), line
    assert all(len(source) > 20 for source in tomllib.loads(text)["sources"].values())


def test_unknown_vehicle_is_answered_with_the_nearest_name():
    assert complaint("corvete").startswith(
        "unknown vehicle 'corvete' (did you mean 'corvette'?): choose from "
    )
    assert "name a .toml file" in complaint("corvete")


def test_a_copy_of_a_file_is_the_same_vehicle(tmp_path):
    for name in names():
        copy = tmp_path / f"{name}.toml"
        copy.write_bytes((DATA / f"{name}.toml").read_bytes())
        assert load(copy) == load(str(copy)) == load(name)


# --- what may be given ----------------------------------------------------------------------------


def test_a_small_file_is_a_vehicle(write):
    ship = load(write(SHIP))
    assert isinstance(ship, CorvetteParameters)
    assert (ship.length, ship.rudder_limit, ship.x_g) == (60.0, np.deg2rad(30.0), 0.0)
    assert steady_turns(ship).radius[-1] < 2.5 * ship.length
    assert isinstance(load(write(TORPEDO)), SegorogeniParameters)
    assert isinstance(load(write(TORPEDO.replace("auv", "vertical-auv"))), ItsunusaParameters)
    rov = load(write(THRUSTERS))
    np.testing.assert_array_equal(rov.allocation[:, 0], [1.0, 0.0, 0.0, 0.0, 0.0, -0.2])
    assert (rov.X_u, rov.thrust_lag) == (0.0, 0.1)
    wing = load(write(WING))
    assert trim(18.0, wing).thrust < wing.thrust_limit


@pytest.mark.parametrize(
    ("name", "coefficient", "power"),
    [("Yv", "Yv", 2), ("Yr", "Yr", 3), ("Nv", "Nv", 3), ("Nr", "Nr", 4), ("Yvdot", "sway_inertia", 3),
     ("Yrdot", "sway_yaw_inertia", 4), ("Nvdot", "yaw_sway_inertia", 4), ("Nrdot", "yaw_inertia", 5),
     ("Xudot", "surge_inertia", 3)],
)  # fmt: skip
def test_given_ship_derivative_replaces_only_itself(write, name, coefficient, power):
    usual = load(write(SHIP)).clarke.get(name, -2e-4)
    less, more = (
        load(write(f"{SHIP}\n[derivatives]\n{name} = {float(share * usual)!r}\n")).vector()
        for share in (1.0, 1.1)
    )
    changed = np.flatnonzero(less != more)
    assert changed.tolist() == [COEFFICIENTS.index(coefficient)]
    sign = -1.0 if name.endswith("dot") else 1.0  # an added mass is a force against acceleration
    expected = sign * 0.05 * 1025.0 * 60.0**power * usual
    assert (more - less)[changed[0]] == pytest.approx(expected, rel=1e-9)


def test_a_given_rudder_force_replaces_area_and_aspect_ratio(write):
    text = SHIP.replace("rudder_area = 5.0", "Ydelta = -3e-3\nslipstream = 1.2")
    c = dict(zip(COEFFICIENTS, load(write(text)).vector(), strict=True))
    assert c["rudder"] * 1.2**2 == pytest.approx(0.5 * 1025.0 * 60.0**2 * 3e-3)  # per u^2 and angle


@pytest.mark.parametrize(("ratio", "drag"), [(0.988, 0.828), (1.639, 0.691)])
def test_cross_flow_drag_is_that_of_hoerners_curve(write, ratio, drag):
    draught = 5.0 / ratio
    text = SHIP.replace("draught = 3.0", f"draught = {draught!r}")
    found = load(write(text)).vector()[COEFFICIENTS.index("cross_flow")]
    assert found == pytest.approx(0.5 * 1025.0 * draught * drag)


@pytest.mark.parametrize("name", Coefficients._fields)
def test_given_auv_coefficient_replaces_only_itself(write, name):
    partner = {"Y_rdot": "N_vdot", "N_vdot": "Y_rdot", "Z_qdot": "M_wdot", "M_wdot": "Z_qdot"}.get(
        name, name
    )
    estimated = load(write(TORPEDO)).coefficients._asdict()
    value = float(0.9 * estimated[name])
    lines = "".join(f"{each} = {value!r}\n" for each in {name, partner})
    found = load(write(f"{TORPEDO}\n[coefficients]\n{lines}")).coefficients._asdict()
    assert found == estimated | {name: value, partner: value}


def test_an_angle_may_be_in_degrees_or_in_radians(write):
    radians = SHIP.replace("rudder_limit_deg = 30", f"rudder_limit = {float(np.deg2rad(30.0))!r}")
    assert load(write(radians)) == load(write(SHIP))


# --- what is wrong --------------------------------------------------------------------------------

WRONG = [  # file, what is replaced by what, the line, the sentence
    (SHIP, "length = 60.0", "lenght = 60.0", 4, r"unknown key 'lenght' \(did you mean 'length'\?\)"),
    (SHIP, 'kind = "ship"', 'kind = "ship"\nspeed = 7.0', 2, "unknown key outside of tables 'speed'"),
    (SHIP, "beam = 10.0\n", "", 1, "a ship needs a 'beam'"),
    (SHIP, "[rudder]\nrudder_area = 5.0\nrudder_limit_deg = 30\n", "", 1, "the rudder needs 'rudder_area', or"),
    (SHIP, "mass = 0.9e6", "mass = 900.0", 7, "900 kg are no mass of a hull in a box that displaces 1.845e\\+06 kg"),
    (SHIP, "_deg = 30", "_deg = 120", 11, "rudder_limit_deg must be an angle above 0 and below 90 degrees, got 120"),
    (SHIP, "_deg = 30", "_deg = 30\nrudder_limit = 0.5", 12, "rudder_limit is given twice"),
    (SHIP, "[rudder]", "[derivatives]\nYv = 0.01\n[rudder]", 10, "Yv must be a number of at most 0: it resists"),
    (SHIP, "[rudder]", "[derivatives]\nNvdot = 1.0\nYrdot = 1.0\n[rudder]", 9, "an inertia that is not positive"),
    (SHIP, "speed = 7.0", "thrust_coefficient = 0.2\nthrust_slope = 0.4\nadvance_ratio = 0.5\nspeed = 7.0", 14,
     "propellers of this slope give no thrust at this J"),
    (SHIP, "[rudder]", "[sources]\nmass = 3\n[rudder]", 10, "a source is a text, got 3"),
    (SHIP, "[particulars]\nlength = 60.0",
     '[sources]\na = """\n[particulars]\nlength = 60\n"""\n[particulars]\nlength = -60', 9,
     "length must be a number above 0"),
    (TORPEDO, "diameter = 0.2", "diameter = 2.0", 5, "a torpedo of 1.5 m is not 2 m thick"),
    (TORPEDO, "z_g", "mass = 400.0\nz_g", 6, "400 kg do not float: a cylinder round the hull displaces 48.3 kg"),
    (TORPEDO, "= 15.0", "= 1.0", 14, "1 N are too little: at cruising speed the drag is"),
    (TORPEDO, "[fins]", "[coefficients]\nY_rdot = 30.0\nN_vdot = 30.0\n[fins]", 8, "is not positive definite"),
    (TORPEDO, "[fins]", "[coefficients]\nY_rdot = 0.1\n[fins]", 8, "added mass is symmetric: Y_rdot is N_vdot"),
    (THRUSTERS, "[[0.1, 0.2, 0.0], [", "[[0.1, 0.2], [", 11, r"each of positions must be a list of 3 finite numbers"),
    (THRUSTERS, "[[1, 0, 0], [1, 0, 0]]", "[[1, 0, 0]]", 12, "2 thrusters have no 1 directions"),
    (THRUSTERS, "z_g", "buoyancy_excess = -100.0\nz_g", 8, "100 N are more than the weight: it displaces no water"),
    (WING, "lift = [4.0, 0.1]", "lift = [-4.0, 0.1]", 8, "a wing lifts more at a higher angle of attack"),
    (WING, "drag = [1.0, 0.1, 0.02]", "drag = [1.0, 0.1, -0.02]", 9, "it becomes a thrust"),
    (WING, "18.0", "1.8", 12, "no level flight at 1.8 m/s"),
    (WING, "[propulsion]", "[limits]\nalpha_low_deg = 15.0\n[propulsion]", 12, "no lower limit"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "old", "new", "line", "sentence"), WRONG)
def test_mistake_is_said_in_one_sentence_with_its_line(write, text, old, new, line, sentence):
    assert old in text
    said = complaint(write(text.replace(old, new, 1)))
    assert re.match(rf"my\.toml, line {r'[0-9]+' if line is None else line}: ", said), said
    assert sentence is None or re.search(sentence, said), said
    assert "\n" not in said
    assert len(said) < 700


def test_vehicle_of_another_kind_is_refused(write):
    said = complaint(write(TORPEDO), CorvetteParameters)
    assert said.startswith(
        "my.toml, line 1: kind 'auv', where Corvette is needed: docs/vehicles.md"
    )
    assert "kind 'rov', where AUV is needed" in complaint("bluerov2-heavy", AUVParameters)
    assert "where Segorogeni is needed" in complaint("itsunusa", SegorogeniParameters)
    assert load("itsunusa", AUVParameters) is load("itsunusa")


@settings(max_examples=40, deadline=None)
@given(factor=st.floats(0.2, 4.0), straight=st.floats(0.0, 1.0), x_g=st.floats(-3.0, 3.0))
def test_unstable_ships_hold_wide_turns_by_opposite_rudder(factor, straight, x_g):
    ship = load("corvette")
    ship = replace(
        ship, given=(("Nv", factor * ship.clarke["Nv"]),), straightening=straight, x_g=x_g
    )
    A = ship.jacobian(np.array([ship.speed, 0.0, 0.0, 0.0]))[1:, 1:3]
    growth = np.linalg.eigvals(A).real.max() * ship.length / ship.speed
    turns = steady_turns(ship)
    assert turns.rudder[-1] > 0.0
    if abs(growth) > 0.02:  # the first turn of the table has cross-flow drag
        assert (turns.rudder[1] < 0.0) == (growth > 0.0)


def test_a_ship_that_hard_rudder_stops_has_no_steady_turns():
    with pytest.raises(RuntimeError, match="no steady turn at 80 % of the rudder limit"):
        steady_turns(replace(load("corvette"), drag_coefficient=0.0))


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_any_file_is_a_vehicle_or_one_sentence_with_a_line(data, tmp_path_factory):
    lines = data.draw(st.sampled_from([SHIP, TORPEDO, WING, THRUSTERS])).split("\n")
    where = data.draw(st.integers(0, len(lines) - 1))
    keys = st.sampled_from(
        ["length", "mass", "speed", "lift", "kind", "rudder", "[rudder]", "z_g", "x", '"a b"', ""]
    )
    values = st.one_of(
        st.floats().map(repr), st.integers().map(str), st.booleans().map(lambda b: str(b).lower()),
        st.lists(st.floats(-10, 10), max_size=3).map(str), st.text("ab\"'[]{}=#\\\n", max_size=6), st.just("{ a = 1 }"),
    )  # fmt: skip
    new = f"{data.draw(keys)} = {data.draw(values)}"
    lines[where : where + data.draw(st.integers(0, 1))] = [new]
    path = tmp_path_factory.mktemp("files") / "my.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    try:
        assert np.isfinite(load(path).vector()).all()
        return
    except ValueError as error:
        said = str(error)
    found = re.fullmatch(rf"{re.escape(str(path))}, line ([1-9][0-9]*): [^\n]+", said)
    assert found, said
    assert int(found[1]) <= len("\n".join(lines).split("\n"))
