"""PX4's ULog, written here by its published format."""

import struct
from pathlib import Path

import numpy as np
import pytest

from vessel_gym.logs import LogError, read, read_columns
from vessel_gym.logs.inspection import inspect


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def ulog(count: int) -> bytes:
    """Local position at 10 Hz, angular velocity at 50 Hz, a servo at 5 Hz; the times of each begin where they like."""
    topics = {
        "vehicle_local_position": ("uint64_t timestamp;float x;float y;float heading;", 100_000),
        "vehicle_angular_velocity": ("uint64_t timestamp;float[3] xyz;", 20_000),
        "actuator_servos": ("uint64_t timestamp;float[2] control;", 200_000),
    }
    content = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0)
    content += message("B", bytes(8 + 8) + bytes(24))
    for name, (fields, _) in topics.items():
        content += message("F", f"{name}:{fields}".encode())
    for number, name in enumerate(topics):
        content += message("A", struct.pack("<BH", 0, number) + name.encode())
    for k in range(count):
        t = 1_000_000 + 100_000 * k
        content += message("D", struct.pack("<HQfff", 0, t, 0.5 * k, 0.25 * k, 0.01 * k))
        for j in range(5):
            content += message("D", struct.pack("<HQfff", 1, t + 20_000 * j, 0.0, 0.0, 0.1 + 0.001 * j))
        if k % 2 == 0:
            content += message("D", struct.pack("<HQff", 2, t + 7_000, 0.2, -0.4))
    return content


MAP = 'rudder = {column = "actuator_servos.control[1]", unit = "rad", sign = -1}\n'


def test_topics_keep_their_own_times(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    (tmp_path / "log.ulg").write_bytes(ulog(100))
    (tmp_path / "map.toml").write_text(MAP)
    found = read(tmp_path / "log.ulg", read_columns(tmp_path / "map.toml"))
    assert set(found.channels) == {"x", "y", "heading", "yaw rate", "rudder"}
    np.testing.assert_allclose(found["x"].times, 1.0 + 0.1 * np.arange(100))
    np.testing.assert_allclose(found["x"].values, 0.5 * np.arange(100))
    np.testing.assert_allclose(found["yaw rate"].times, 1.0 + 0.02 * np.arange(500), rtol=1e-12)
    np.testing.assert_allclose(found["yaw rate"].values[:5], 0.1 + 0.001 * np.arange(5), rtol=1e-6)
    np.testing.assert_allclose(found["rudder"].times[0], 1.007)
    np.testing.assert_allclose(found["rudder"].values, 0.4, rtol=1e-6)
    assert [each for each in inspect(found) if each.kind in ("time", "gap")] == []
    assert set(read(tmp_path / "log.ulg").channels) == {"x", "y", "heading", "yaw rate"}


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 a zip", ulog(3)[:40], b"ULog\x01\x12\x35\x01" + bytes(8)])
def test_what_is_no_ulog_is_refused(content: bytes, tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    (tmp_path / "log.ulg").write_bytes(content)
    with pytest.raises(LogError, match=r"log\.ulg"):
        read(tmp_path / "log.ulg")


def test_a_column_that_is_not_there_is_named(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    (tmp_path / "log.ulg").write_bytes(ulog(10))
    (tmp_path / "map.toml").write_text('rudder = "actuator_servos.angle"\n')
    with pytest.raises(LogError, match=r"no column 'actuator_servos\.angle' for the rudder"):
        read(tmp_path / "log.ulg", read_columns(tmp_path / "map.toml"))
