"""Damaged logs: each is read as far as it can be, or refused in one sentence, in bounded memory."""

import tracemalloc
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vessel_gym.identification.voyages import coefficients, trial, write
from tests.vessel_gym.logs.test_sentences import voyage
from tests.vessel_gym.logs.test_ulog import ulog
from vessel_gym.identification.trial import trials
from vessel_gym.logs import LogError, read
from vessel_gym.logs.inspection import inspect

ODD = [
    b"",
    b"\0",
    b'"',
    b",",
    b";",
    b"\n",
    b"\r",
    b"nan",
    b"1e400",
    b"-inf",
    b"9" * 400,
    b"\xff\xfe",
    b"0x1F",
    b"$GPGGA,",
]


BYTES = 30
"""Of memory at most for each number of a log that is inspected: it is kept once, in 8, and looked at by channels."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Sound logs by suffix."""
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    folder, rng = tmp_path_factory.mktemp("whole"), np.random.default_rng(0)
    write(folder / "log.csv", trial(rng, coefficients(rng), 60.0))
    table = np.genfromtxt(folder / "log.csv", delimiter=",", names=True, deletechars="")
    columns = {name.replace("_", " "): np.asarray(table[name]) for name in table.dtype.names or ()}
    parquet.write_table(pyarrow.table(columns), folder / "log.parquet")
    (folder / "log.nmea").write_text("\n".join(voyage(30)))
    (folder / "log.ulg").write_bytes(ulog(20))
    return {path.suffix: path.read_bytes() for path in folder.iterdir()}


@st.composite
def damages(draw: st.DrawFn) -> list[tuple[str, float, float, bytes]]:
    """Cuts, repetitions and odd bytes at places between 0 and 1 of the file."""
    place = st.floats(0.0, 1.0)
    kinds = st.sampled_from(["cut", "repeat", "insert", "end", "replace"])
    return draw(st.lists(st.tuples(kinds, place, place, st.sampled_from(ODD) | st.binary(max_size=8)), max_size=4))


def damaged(content: bytes, damage: list[tuple[str, float, float, bytes]]) -> bytes:
    for kind, start, length, new in damage:
        a = int(start * len(content))
        b = a + int(length**4 * len(content))
        if kind == "cut":
            content = content[:a] + content[b:]
        elif kind == "repeat":
            content = content[:b] + content[a:]
        elif kind == "insert":
            content = content[:a] + new + content[a:]
        elif kind == "end":
            content = content[: max(a, 1)]
        else:
            content = content[:a] + new + content[a + len(new) :]
    return content


def inspected(path: Path) -> str | None:
    """Read a log, list its faults, make it trials; the sentence that refuses it."""
    try:
        found = read(path)
        assert all("\n" not in each.sentence and each.line >= 1 for each in inspect(found))
        trials(found, 0.2)
    except LogError as error:
        return str(error)
    return None


@pytest.mark.parametrize("suffix", [".csv", ".nmea", ".parquet", ".ulg"])
def test_damaged_logs_are_inspected_or_refused(
    suffix: str, whole: dict[str, bytes], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("damaged") / f"log{suffix}"

    @settings(max_examples=100, deadline=None, derandomize=True)
    @given(damages())
    def check(damage: list[tuple[str, float, float, bytes]]) -> None:
        path.write_bytes(damaged(whole[suffix], damage))
        refusal = inspected(path)
        assert refusal is None or (path.name in refusal and "\n" not in refusal)

    check()


@pytest.mark.parametrize("header", [b"", b"t,x\n0,1\n1,2\n"])
def test_a_file_of_a_gigabyte_without_lines_is_refused_in_little_memory(header: bytes, tmp_path: Path) -> None:
    with (tmp_path / "log.csv").open("wb") as file:
        file.write(header)
        file.truncate(2**30)
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match=r"log\.csv, line (1|4): longer than"):
            read(tmp_path / "log.csv")
        assert tracemalloc.get_traced_memory()[1] < 2**25
    finally:
        tracemalloc.stop()


def test_memory_is_in_proportion_to_the_numbers_of_a_log(tmp_path: Path) -> None:
    """So that the most rows that are read bound it: 4 million of 11 channels are 44 million numbers of 8 bytes."""
    peaks = []
    for count in (10_000, 40_000):
        rng, path = np.random.default_rng(0), tmp_path / f"{count}.csv"
        table = np.cumsum(rng.normal(size=(count, 11)), 0) * 1e-3
        table[:, 0] = 0.1 * np.arange(count)
        head = "time,x,y,heading,yaw rate,surge,sway,rudder,revolutions,wind speed,wind direction"
        np.savetxt(path, table, "%.6g", ",", header=head, comments="")
        tracemalloc.start()
        try:
            inspect(read(path))
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert peaks[1] - peaks[0] < 30_000 * 11 * BYTES
    assert peaks[1] < 4.5 * peaks[0]


def test_a_log_of_too_many_rows_is_refused_at_the_first_that_is_too_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(import_module("vessel_gym.logs.read"), "MOST_ROWS", 1000)
    (tmp_path / "log.csv").write_text("t,x\n" + "".join(f"{k},{k}\n" for k in range(1000)))
    assert len(read(tmp_path / "log.csv")["x"].values) == 1000
    with (tmp_path / "log.csv").open("a") as file:
        file.write("1000,0\n")
    with pytest.raises(LogError, match=r"log\.csv, line 1002: more than 1,000 rows; thin the log, or cut it in parts"):
        read(tmp_path / "log.csv")
