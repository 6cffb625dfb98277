"""NMEA 0183: what a simulated ship's instruments say is read back, its times too."""

from pathlib import Path

import numpy as np
import pytest

from vessel_gym.logs import Columns, LogError, read, read_columns, rows
from vessel_gym.logs.inspection import inspect


def sentence(body: str) -> str:
    """With its checksum: the exclusive or of its characters."""
    check = 0
    for letter in body:
        check ^= ord(letter)
    return f"${body}*{check:02X}"


def degrees(value: float, letters: str, digits: int) -> str:
    """Degrees and minutes, and the hemisphere."""
    whole, part = divmod(abs(value), 1.0)
    return f"{int(whole):0{digits}d}{60.0 * part:010.7f},{letters[value < 0.0]}"


def clock(t: float) -> str:
    """Time of day."""
    seconds = round(1000 * t) % 86_400_000
    return f"{seconds // 3_600_000:02d}{seconds // 60_000 % 60:02d}{seconds / 1000 % 60:06.3f}"


def fix(t: float, latitude: float = -7.0, longitude: float = 112.0) -> str:
    return sentence(f"GPGGA,{clock(t)},{degrees(latitude, 'NS', 2)},{degrees(longitude, 'EW', 3)},1,08,1.0,0,M,0,M,,")


def log(tmp_path: Path, lines: list[str], name: str = "log.nmea", columns: str = ""):  # type: ignore[no-untyped-def]
    (tmp_path / name).write_text("\r\n".join(lines) + "\r\n", encoding="utf-8")
    (tmp_path / "columns.toml").write_text(columns, encoding="utf-8")
    return read(tmp_path / name, read_columns(tmp_path / "columns.toml"))


def voyage(seconds: int, start: float = 0.0) -> list[str]:
    """Fixes at 1 Hz, a heading at 5 Hz, and what comes once with each fix."""
    lines = []
    for k in range(seconds):
        lines += [
            fix(start + k, -7.0 + 1e-5 * k, 179.9999 + 2e-5 * k if k < 5 else -180.0001 + 2e-5 * k),
            sentence(f"TIROT,{-6.0 + k},A"),
            sentence(f"IIRSA,{0.5 * k},A,,V"),
            sentence(f"IIRPM,S,1,{60 + k},0,A"),
            sentence(f"IIRPM,E,1,{600 + k},0,A"),
            sentence("WIMWV,90.0,R,10.0,N,A"),
            sentence("WIMWD,270.0,T,,M,5.0,N,2.6,M"),
        ]
        for j in range(5):
            lines.append(sentence(f"HEHDT,{(350.0 + 2 * k + 0.4 * j) % 360.0:.1f},T"))
        lines.append(sentence(f"GPVTG,{(350.0 + 2 * k + 1.6 + 30.0) % 360:.1f},T,,M,10.0,N,18.52,K,A"))
    return lines


def test_the_instruments_are_read_in_si_units(tmp_path: Path) -> None:
    found = log(tmp_path, voyage(10))
    assert found.remarks == ()
    k = np.arange(10)
    np.testing.assert_allclose(found["x"].values, 1e-5 * k * 110582.4, rtol=2e-4)
    np.testing.assert_allclose(found["y"].values, 2e-5 * k * 110495.1, rtol=2e-4)  # over the date line
    np.testing.assert_allclose(found["yaw rate"].values, np.deg2rad(-6.0 + k) / 60.0)
    np.testing.assert_allclose(found["rudder"].values, np.deg2rad(0.5 * k))
    np.testing.assert_allclose(found["revolutions"].values, (60 + k) / 60.0)
    np.testing.assert_allclose(found["relative wind speed"].values, 10.0 * 1852 / 3600)
    np.testing.assert_allclose(found["wind speed"].values, 2.6)
    np.testing.assert_allclose(found["wind direction"].values, np.deg2rad(270.0))
    speed = 10.0 * 1852 / 3600
    np.testing.assert_allclose(found["surge"].values, speed * np.cos(np.pi / 6))
    np.testing.assert_allclose(found["sway"].values, speed * np.sin(np.pi / 6))
    np.testing.assert_allclose(np.unwrap(found["heading"].values)[-1], np.deg2rad(369.6), rtol=1e-12)


def test_sentences_between_two_fixes_are_spread_over_the_time_between(tmp_path: Path) -> None:
    found = log(tmp_path, voyage(10, start=100.0))
    np.testing.assert_allclose(found["heading"].times, 100.0 + 0.2 * np.arange(50))
    np.testing.assert_allclose(found["yaw rate"].times, 100.0 + np.arange(10))
    assert [each.kind for each in inspect(found) if each.kind in ("time", "gap")] == []


def test_days_go_on_at_midnight_and_over_dates(tmp_path: Path) -> None:
    found = log(tmp_path, voyage(10, start=86395.0))
    np.testing.assert_allclose(found["x"].times, 86395.0 + np.arange(10))

    def dated(day: str, t: float) -> str:
        return sentence(f"GPRMC,{clock(t)},A,0700.0,S,11200.0,E,5.0,0.0,{day},,,A")

    lines = [dated("311225", 86398.0), dated("311225", 86399.0), dated("010126", 0.0), dated("040126", 5.0)]
    times = log(tmp_path, lines)["x"].times
    np.testing.assert_allclose(np.diff(times), [1.0, 1.0, 3 * 86400.0 + 5.0])


def test_one_fix_in_three_sentences_counts_once(tmp_path: Path) -> None:
    lines = []
    for t in range(5):
        place = f"{degrees(-7.0, 'NS', 2)},{degrees(112.0, 'EW', 3)}"
        lines += [
            sentence(f"GPRMC,{clock(t)},A,{place},5.0,0.0,311225,,,A"),
            fix(t),
            sentence(f"GPGLL,{place},{clock(t)},A,A"),
        ]
    np.testing.assert_allclose(log(tmp_path, lines)["x"].times, np.arange(5.0))


@pytest.mark.parametrize("prefix", ["{t:.3f} ", "{t:.3f},", "2026-01-01T00:00:{t:06.3f}Z;", "\\s:nav,c:{ms:.0f}*00\\"])
def test_times_in_front_of_sentences_are_when_they_came(prefix: str, tmp_path: Path) -> None:
    times = [10.0, 10.4, 11.1, 11.15]
    heard = [1767225600.0 + t for t in times] if "c:" in prefix else times
    lines = [prefix.format(t=t, ms=1e3 * t) + sentence("HEHDT,90.0,T") for t in heard]
    np.testing.assert_allclose(np.diff(log(tmp_path, lines)["heading"].times), np.diff(times), atol=1e-6)


@pytest.mark.parametrize(
    ("damage", "sentence_of_it"),
    [
        (sentence("HEHDT,90.0,T").replace("90", "91"), "HDT: the checksum does not match"),
        (sentence("GPGGA,000003.000,,,,,0,00,,,M,,M,,"), "GGA: it has no fix"),
        (sentence("HEHDT,,T"), "HDT: it has no heading"),
        (sentence("HEHDT,north,T"), "HDT: it has no heading"),
        (sentence("TIROT,5.0,V"), "ROT: the instrument says that it is not valid"),
        ("$HEHDT,", "HDT: "),
    ],
)
def test_damaged_sentences_are_left_out_and_named(damage: str, sentence_of_it: str, tmp_path: Path) -> None:
    lines = [fix(0.0), fix(1.0), fix(2.0), damage, fix(3.0)]
    found = log(tmp_path, lines)
    assert [line for line, _ in found.remarks] == [4]
    assert found.remarks[0][1].startswith(sentence_of_it)
    np.testing.assert_array_equal(found["x"].times, np.arange(4.0))


def test_a_column_map_changes_signs_and_keeps_the_rest(tmp_path: Path) -> None:
    found = log(tmp_path, voyage(4), columns="[rudder]\nsign = -1\n")
    np.testing.assert_allclose(found["rudder"].values, -np.deg2rad(0.5 * np.arange(4)))
    assert "heading" in found


def test_a_magnetic_heading_is_corrected_and_used_where_there_is_no_true_one(tmp_path: Path) -> None:
    magnetic = [sentence(f"SDHDG,{359.0 + k:.1f},0.5,W,1.5,E") for k in range(3)]
    found = log(tmp_path, [line for k in range(3) for line in (fix(k), magnetic[k])])
    np.testing.assert_allclose(np.rad2deg(found["heading"].values), [0.0, 1.0, 2.0], atol=1e-9)
    both = log(tmp_path, [line for k in range(3) for line in (fix(k), sentence("HEHDT,90.0,T"), magnetic[k])])
    np.testing.assert_allclose(np.rad2deg(both["heading"].values), 90.0)
    bare = log(tmp_path, [line for k in range(3) for line in (fix(k), sentence("SDHDG,10.0,,,,"))])
    assert "heading" not in bare
    (said,) = [each.sentence for each in inspect(bare) if each.kind == "damaged row"]
    assert said == "HDG: it has no variation, so that its heading is magnetic, as of 2 other rows until line 6"


@pytest.mark.parametrize(
    "first", ["# Name: a receiver\n#\n\n", "$PSRF151,1*3F\n", "!AIVDM,1,1,,B,15N4cJ`005Jrek0H@9n`DW5608EP,0*13\n"]
)
def test_sentences_are_told_below_comments_and_other_sentences(first: str, tmp_path: Path) -> None:
    """Loggers write names and dates above the first sentence, and receivers say what is their maker's."""
    (tmp_path / "log.txt").write_text(first + "\n".join(voyage(4)), encoding="utf-8")
    assert {"x", "heading", "rudder"} <= set(read(tmp_path / "log.txt").channels)
    with (tmp_path / "log.txt").open() as pipe:
        assert len(list(rows(pipe, Columns({})))) > 20


def test_what_has_no_time_or_no_sentence_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="fewer than two rows have a time; line 1: HDT: no time has come before it"):
        log(tmp_path, [sentence("HEHDT,90.0,T")] * 5)
    with pytest.raises(LogError, match="fewer than two rows have a time"):
        log(tmp_path, ["nothing"] * 5)


def test_a_pipe_of_sentences_gives_each_as_it_comes() -> None:
    came = []

    def pipe():  # type: ignore[no-untyped-def]
        for line in [fix(0.0), sentence("HEHDT,90.0,T")]:
            came.append(line)
            yield line + "\r\n"

    parsed = rows(pipe(), Columns({}))
    names = [each.channel for each in next(parsed)]
    line, numbers = next(parsed)
    assert (line, len(came)) == (1, 1)
    row = dict(zip(names, numbers, strict=True))
    assert row["latitude"] == -7.0
    assert np.isnan(row["heading"])
    assert dict(zip(names, next(parsed)[1], strict=True))["heading"] == np.pi / 2
