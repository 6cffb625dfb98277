"""Reading logs: formats, units, damaged rows, and their way into trials."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vessel_gym.identification.voyages import SHIP, STEP, coefficients, trial, write
from vessel_gym.identification.trial import common_step, trials
from vessel_gym.logs import Columns, Log, LogError, read, read_columns, rows


def log(tmp_path: Path, text: str, columns: str = "") -> Log:
    """The log of a text."""
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    if not columns:
        return read(tmp_path / "log.csv")
    (tmp_path / "columns.toml").write_text(columns, encoding="utf-8")
    return read(tmp_path / "log.csv", read_columns(tmp_path / "columns.toml"))


def test_units_come_from_headers_or_the_map(tmp_path: Path) -> None:
    found = log(tmp_path, "t,Heading [deg];x\n".replace(";", ",") + "0,180,1\n1,90,2\n")
    np.testing.assert_allclose(found["heading"].values, [np.pi, np.pi / 2])
    np.testing.assert_allclose(found["x"].values, [1.0, 2.0])
    columns = 'time = {column = "T", unit = "ms"}\nheading = {column = "H", unit = "deg", sign = -1, offset = 90}\n'
    found = log(tmp_path, "T;H;speed\n0;180;3\n500;90;3\n", columns)
    np.testing.assert_allclose(found["heading"].times, [0.0, 0.5])
    np.testing.assert_allclose(found["heading"].values, [-np.pi / 2, 0.0], atol=1e-15)
    assert set(found.channels) == {"heading"}


def test_times_may_be_dates_and_positions_degrees(tmp_path: Path) -> None:
    text = "time,latitude,longitude\n2020-11-12T11:07:23Z,-7.0,112.0\n2020-11-12T11:07:24.5Z,-6.9991,112.0009\n"
    found = log(
        tmp_path, text, 'time = {column = "time", unit = "iso"}\nlatitude = "latitude"\nlongitude = "longitude"\n'
    )
    np.testing.assert_allclose(np.diff(found["x"].times), 1.5)
    # A degree of latitude there is 110,582.4 m, one of longitude 110,495.1 m (WGS 84, Vincenty's formula).
    np.testing.assert_allclose(found["x"].values, [0.0, 0.0009 * 110582.4], rtol=2e-4)
    np.testing.assert_allclose(found["y"].values, [0.0, 0.0009 * 110495.1], rtol=2e-4)


def test_damaged_rows_are_kept_as_far_as_they_can_be_read_and_named(tmp_path: Path) -> None:
    found = log(tmp_path, "t,x,y\n0,1,2\n1,,2\n2,oops,2\n\n3,4\n4,5,6\n")
    np.testing.assert_array_equal(found["x"].values, [1.0, np.nan, np.nan, 4.0, 5.0])
    assert [line for line, _ in found.remarks] == [4, 6]
    assert "'oops', which is no number" in found.remarks[0][1]
    assert "2 fields" in found.remarks[1][1]
    np.testing.assert_array_equal(found["y"].measured()[0], [0.0, 1.0, 2.0, 4.0])


def test_parquet_is_read_as_the_csv_of_the_same_columns(tmp_path: Path) -> None:
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {"t": [0.0, 0.1, 0.2], "heading [deg]": [10.0, None, 30.0], "x": [1, 2, 3]}
    parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    found, same = read(tmp_path / "log.parquet"), log(tmp_path, "t,heading [deg],x\n0,10,1\n.1,,2\n.2,30,3\n")
    for name in same.channels:
        np.testing.assert_array_equal(found[name].values, same[name].values)
        np.testing.assert_array_equal(found[name].lines, same[name].lines)
    (tmp_path / "broken.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(LogError, match=r"broken\.parquet: not a Parquet file"):
        read(tmp_path / "broken.parquet")


def test_rows_come_one_by_one_from_a_pipe() -> None:
    read_so_far = []

    def pipe():  # type: ignore[no-untyped-def]
        for line in ("t,x\n", "0,1\n", "1,2\n"):
            read_so_far.append(line)
            yield line

    parsed = rows(pipe(), Columns({}))
    next(parsed)
    assert next(parsed) == (2, [0.0, 1.0])
    assert len(read_so_far) == 2


@pytest.mark.parametrize(
    ("text", "columns", "sentence"),
    [
        ("", "", "line 1: a log begins with a line that names its columns"),
        ("a,b\n1,2\n", "", "line 1: no column is the time"),
        ("t,b\n1,2\n", "", "line 1: no column is a known channel; write a column map of some of x, y"),
        ("t,x\n1,2\n", "", "line 2: fewer than two rows have a time"),
        ("t,x\n1,2\n2,3\n", 'x = "X"\nheading = "h"\n', "there is no column 'h' for the heading"),
        ("t,x [furlong]\n1,2\n2,3\n", "", "unknown unit of x 'furlong'"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path: Path, text: str, columns: str, sentence: str) -> None:
    with pytest.raises(LogError) as error:
        log(tmp_path, text, columns)
    assert sentence in str(error.value)


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ('head = "h"', "line 1: unknown channel 'head'"),
        ("[x]\ncolumn = 3", "line 2: column must be a text, got 3"),
        ('[x]\ncolumn = "x"\nsign = 2', "line 3: sign must be 1 or -1, got 2"),
        ('[x]\ncolum = "x"', "line 2: unknown key of x 'colum'"),
    ],
)
def test_a_mistake_in_a_column_map_is_named(tmp_path: Path, columns: str, sentence: str) -> None:
    with pytest.raises(ValueError, match="line") as error:
        log(tmp_path, "t,x\n0,1\n1,2\n", columns)
    assert sentence in str(error.value)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_are_a_log_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "bytes.csv"
    path.write_bytes(b"t,x,heading [deg]\n0,1,2\n1,2,3\n" + content)
    found = read(path)
    assert len(found["x"].times) >= 2
    path.write_bytes(content)
    with suppress(LogError):
        assert len(read(path).channels) > 0


def test_a_log_on_a_grid_of_its_own_becomes_the_trial(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    voyage = trial(rng, coefficients(rng), 120.0)
    write(tmp_path / "log.csv", voyage)
    found = read(tmp_path / "log.csv")
    assert STEP / 3 < common_step([found], SHIP) < 3 * STEP
    (again,) = trials(found, STEP)
    np.testing.assert_allclose(again.control, voyage.control[: len(again)], atol=1e-5)
    np.testing.assert_allclose(again.states[20:-20, :2], voyage.states[20:-21, :2], atol=0.1)
    new = np.diff(found["heading"].values, prepend=0.0)[20:-20] != 0.0  # a rounded one that repeats counts as held
    np.testing.assert_allclose(again.states[20:-20, 2][new], voyage.states[20:-21, 2][new], atol=1e-4)
    assert new.mean() > 0.99


def test_gaps_part_a_log(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    write(tmp_path / "log.csv", trial(rng, coefficients(rng), 120.0))
    lines = (tmp_path / "log.csv").read_text().splitlines(keepends=True)
    (tmp_path / "log.csv").write_text("".join(lines[:300] + lines[360:]))
    parts = trials(read(tmp_path / "log.csv"), STEP)
    assert [len(part) for part in parts] == [298, 240]  # of 299 and 241 rows
