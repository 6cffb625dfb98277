"""Record what every environment gives on every estimator, and compare it later: what stays must stay as it is.

::

    python -m tests.golden.record                    # compare with tests/golden/golden.npz
    python -m tests.golden.record --only SigmaC 'budget ekf'   # the cases with one of these in their names
    python -m tests.golden.record --record           # write it, or of the cases of --only their part
    python -m tests.golden.record --record --fly     # and let the autopilots give new actions

A case is an environment, a sensor suite, an estimator and one of: ``alone``, an episode of
`gymnasium.make` of at most `STEPS` steps; ``batch``, `ROWS` rows of `gymnasium.make_vec` for
`STEPS` steps, over ends of episodes; ``whole``, an episode to its end. Its actions were flown once
by the autopilot on the truth and are stored, so that no loop amplifies a rounding difference. Only
the public surface is used: ``make``, ``make_vec``, spaces, observations, rewards, ``info``.

Of each component of each quantity the file has two sums over times and rows with fixed weights
between 1/2 and 1 in size, and its range; and every eighth step of whole episodes. The rows of a
covariance are summed with weights, too, after division by the largest standard deviations. A
deviation is that of a sum (or a step) as a share of the range; a component that hardly moves has a
thousandth of its largest value in place of its range. No hashes: they admit no tolerance.

The file keeps the processor and the libraries that it was recorded on, and is compared there: sums
of matrix products are rounded differently on others. `main` compares on any and says so, the
nightly test skips.
"""

import argparse
import json
import os
import platform
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("VESSEL_GYM_OPTIMISE", "0")  # gives the same bits in a third of the time

import gymnasium as gym
import numpy as np

import vessel_gym  # noqa: F401  (registers the environments)

FILE = Path(__file__).with_name("golden.npz")
TOLERANCE = 1e-9
SEED, ROWS, STEPS, THIN = 11, 3, 300, 8

ENVIRONMENTS = (
    "SigmaCorvette-v0", "SigmaChannel-v0", "ThesisCorvette-v0", "SegorogeniAUV-v0", "ItsunusaAUV-v0", "PunaUAV-v0",
)  # fmt: skip
GENERAL = ("vessel_gym/Ship-v0", "vessel_gym/AUV-v0", "vessel_gym/FixedWing-v0", "ROVDocking-v0")
ESTIMATORS = (
    "default", "ekf", "ukf", "enkf", "kf-umv-ui", "huber-kf", "truth", "measurement", "dead-reckoning",
)  # fmt: skip
OTHERS = (
    "kf",
    "kf-umv-ui-wdf",
    "ekf-ui-wdf",
    "ukf-umv",
    "ulise",
    "enkf-sr",
    "etkf",
    "pf",
    "robust-kf",
)
SUITES = ("nominal", "clean", "degraded", "budget", "denied")
VARIANTS: dict[str, dict[str, Any]] = {
    "calm": {"disturbance": "calm"},
    "rough": {"disturbance": "rough"},
    "quartering": {"disturbance": "moderate quartering"},
    "surface": {"disturbance": "surface"},
    "mismatch": {"mismatch": 0.1},
    "mean+std": {"observe": "mean+std"},
    "raw": {"observe": "measurement"},
    "raw-guided": {"observe": "measurement", "guidance": True},
    "unguided": {"guidance": False},
    "task-ends": {"termination": "task"},
    "ekf-linear": {"estimator": "ekf", "estimator_options": {"model": "linear"}},
    "ekf-assuming": {
        "estimator": "ekf", "estimator_options": {"assume": {"disturbance": "moderate", "as": "states"}}
    },
    "umv-assuming": {
        "estimator": "kf-umv-ui", "estimator_options": {"assume": {"disturbance": "moderate", "as": "unknown-input"}}
    },
    "chi-square": {"estimator": "ekf", "estimator_options": {"monitor": "chi-square"}, "sensors": "degraded"},
    "cusum": {"estimator": "ekf", "estimator_options": {"monitor": "cusum"}, "sensors": "degraded"},
    "late": {"estimator": "ekf", "sensors": "late"},
    "late-as-new": {"estimator": "ekf", "sensors": "late", "estimator_options": {"late": "as new"}},
}  # fmt: skip
QUANTITIES = (
    "truth", "unknown_input", "actuators", "measurement", "available", "estimate", "covariance", "input_estimate",
    "healthy", "observation", "reward", "score",
)  # fmt: skip


def cases() -> Iterator[tuple[str, dict[str, Any]]]:
    """Name and arguments of every case that is tried."""
    for env in ENVIRONMENTS:
        for suite in SUITES:
            for estimator in ESTIMATORS:
                for form in ("alone", "batch"):
                    yield (
                        f"{env} {suite} {estimator} {form}",
                        {"sensors": suite, "estimator": estimator},
                    )
        yield f"{env} nominal default whole", {"sensors": "nominal", "estimator": "default"}
        for estimator in OTHERS:
            yield f"{env} nominal {estimator} alone", {"sensors": "nominal", "estimator": estimator}
        for name, options in VARIANTS.items():
            for form in ("alone", "batch")[: 2 if name in ("late", "raw") else 1]:
                yield f"{env} {name} {options.get('estimator', 'default')} {form}", options
    for env in GENERAL:
        for suite in ("nominal", "budget"):
            for estimator in ("default", "ekf", "truth"):
                for form in ("alone", "batch"):
                    yield (
                        f"{env} {suite} {estimator} {form}",
                        {"sensors": suite, "estimator": estimator},
                    )


# --- episodes -------------------------------------------------------------------------------------


def make(name: str, options: dict[str, Any]) -> gym.Env | gym.vector.VectorEnv:
    """The environment of a case."""
    env, *_, form = name.split()
    options = dict(options)
    if options.get("estimator") == "default":
        del options["estimator"]
    if env == "ROVDocking-v0":
        _register_rov()
        if options["sensors"] == "nominal":
            del options["sensors"]
    if options.get("sensors") == "late":
        probe = gym.make(env)
        dt, sensors = probe.unwrapped.system.task.dt, probe.unwrapped.system.vehicle.sensors  # type: ignore[attr-defined]
        options["sensors"] = [
            replace(sensor, latency=(1 + i % 3) * dt) for i, sensor in enumerate(sensors)
        ]
    if form == "batch":
        return gym.make_vec(env, num_envs=ROWS, vectorization_mode="vector_entry_point", **options)
    return gym.make(env, **options)


def _register_rov() -> None:
    """Register the docking environment of the recipe."""
    if "ROVDocking-v0" not in gym.registry:
        page = (Path(__file__).parents[2] / "docs/recipes/rov.md").read_text(encoding="utf-8")
        exec(
            re.findall(r"^```python docking\n(.*?)^```", page, re.M | re.S)[0],
            {"__name__": "docking"},
        )


def flown(env_id: str) -> np.ndarray:
    """Actions ``(T, ROWS, a)`` of the autopilot on the truth, in whole 127ths."""
    from agents import load_agent

    env: Any = make(f"{env_id} nominal truth batch", {"sensors": "nominal", "estimator": "truth"})
    agent = load_agent("autopilot", env)
    agent.reset(ROWS)
    observation, _ = env.reset(seed=SEED)
    actions = []
    for t in range(gym.spec(env_id).max_episode_steps or STEPS):
        wobble = 0.1 * np.sin(0.3 * t + np.arange(env.action_space.shape[-1]))
        action = np.rint(127 * np.clip(agent.act(observation) + wobble, -1, 1)).astype(np.int8)
        actions.append(action)
        observation, *_ = env.step(action.astype(np.float32) / np.float32(127))
    return np.array(actions)


def episode(
    name: str, options: dict[str, Any], tape: np.ndarray
) -> tuple[dict[str, np.ndarray], str]:
    """Quantities of an episode, each ``(T + 1, rows, ...)``, and how it ended."""
    env: Any = make(name, options)
    form, end = name.split()[-1], ""
    alone = form != "batch"
    actions = tape[: len(tape) if form == "whole" else STEPS].astype(np.float32) / np.float32(127)
    actions = actions[:, 0] if alone else actions
    kept: dict[str, list[np.ndarray]] = {quantity: [] for quantity in QUANTITIES}

    def keep(observation: Any, reward: Any, info: dict[str, Any]) -> None:
        for quantity, values in kept.items():
            value = {"observation": observation, "reward": reward}.get(quantity, info.get(quantity))
            if value is not None:
                value = np.array(value, float)
                values.append(value[None] if alone else value)

    observation, info = env.reset(seed=SEED)
    keep(observation, 0.0 if alone else np.zeros(ROWS), info)
    ends = []
    for t, action in enumerate(actions):
        observation, reward, terminated, truncated, info = env.step(action)
        keep(observation, reward, info)
        ended = np.atleast_1d(terminated | truncated)
        words = np.array(getattr(env.unwrapped, "end_reasons", ("",)), object)
        words = words[np.atleast_1d(info.get("end", np.zeros(ended.shape, int)))]
        ends += [f"{words[i] or 'time'} at {t + 1} in row {i}" for i in np.flatnonzero(ended)]
        if alone and ended[0]:
            break
    env.close()
    end = ", ".join(ends) or f"goes on at {len(kept['reward']) - 1}"
    return {quantity: np.array(values) for quantity, values in kept.items() if np.size(values)}, end


# --- sums -----------------------------------------------------------------------------------------


def weights(kind: int, *shape: int) -> np.ndarray:
    """Fixed numbers of size 1/2 to 1 and either sign, by splitmix64: the same wherever integers are."""
    with np.errstate(over="ignore"):
        z = np.arange(1, 1 + int(np.prod(shape)), dtype=np.uint64) + np.uint64(kind) * np.uint64(
            1 << 32
        )
        z *= np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    share = (z >> np.uint64(12)).astype(float) / 2.0**53 + 0.5  # below 1
    return np.where(z & np.uint64(1), share, -share).reshape(shape)


def rows_of(cov: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Weighted sums of the rows of covariances, in units of standard deviations."""
    return (cov / sd[:, None] / sd * weights(9, len(sd))).sum(-1)


def deviations_of(cov: np.ndarray) -> np.ndarray:
    """The largest standard deviations of a covariance's components; 1 where there is none."""
    sd = (
        np.sqrt(np.abs(np.diagonal(cov, axis1=-2, axis2=-1)))
        .max((0, 1))
        .astype(np.float32)
        .astype(float)
    )
    return np.where((sd > 0) & np.isfinite(sd), sd, 1.0)


def scale_of(values: np.ndarray) -> np.ndarray:
    """Range of each component of ``(T, rows, n)``, or a thousandth of the largest value."""
    flat = values.reshape(-1, values.shape[-1])
    with np.errstate(invalid="ignore"):
        scale = np.maximum(np.ptp(flat, axis=0), 1e-3 * np.abs(flat).max(0)).astype(np.float32)
    return np.where((scale > 0) & np.isfinite(scale), scale, np.float32(1))


def sums_of(values: np.ndarray) -> np.ndarray:
    """Two weighted sums ``(2, n)`` over times and rows of ``(T, rows, n)``."""
    return np.array(
        [(weights(k, *values.shape[:2])[..., None] * values).sum(1).sum(0) for k in (1, 2)]
    )


# --- the file -------------------------------------------------------------------------------------


def machine() -> dict[str, str]:
    """Processor and libraries on which results hang."""
    from importlib.metadata import version

    from llvmlite import binding

    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]  # type: ignore[index]
    return {
        "processor": f"{platform.machine()} {binding.get_host_cpu_name()}",
        "blas": f"{blas['name']} {blas['version']}",
        **{name: version(name) for name in ("numpy", "scipy", "llvmlite")},
    }


class Golden:
    """What the file has: ``cases`` by name, with places in ``pool`` and ``scales``; ``tapes`` of actions."""

    def __init__(self, path: Path = FILE) -> None:
        self.machine: dict[str, str] = machine()
        self.cases: dict[str, dict[str, Any]] = {}
        self.tapes: dict[str, np.ndarray] = {}
        if path.exists():
            with np.load(path) as file:
                self.machine, cases = (
                    json.loads(str(file["machine"])),
                    json.loads(str(file["cases"])),
                )
                self.tapes = {key[5:]: file[key] for key in file.files if key.startswith("tape ")}
                arrays = {np.dtype(key): file[key] for key in ("float64", "float32")}
            for name, (end, kept) in cases.items():
                self.cases[name] = {"end": end} | {
                    key: arrays[np.dtype(kind)][at : at + int(np.prod(shape))].reshape(shape)
                    for key, (kind, at, shape) in kept.items()
                }

    def write(self, path: Path = FILE) -> None:
        """Write it; arrays that several cases have are kept once."""
        pool: dict[str, bytearray] = {"float64": bytearray(), "float32": bytearray()}
        places: dict[tuple[str, bytes], int] = {}
        cases = {}
        for name, case in self.cases.items():
            kept = {}
            for key, value in case.items():
                if key == "end":
                    continue
                kind, data = value.dtype.name, np.ascontiguousarray(value).tobytes()
                if (kind, data) not in places:
                    places[kind, data] = len(pool[kind]) // value.itemsize
                    pool[kind] += data
                kept[key] = (kind, places[kind, data], value.shape)
            cases[name] = (case["end"], kept)
        np.savez_compressed(
            path,
            machine=np.array(json.dumps(self.machine)),
            cases=np.array(json.dumps(cases)),
            **{kind: np.frombuffer(bytes(data), kind) for kind, data in pool.items()},  # type: ignore[arg-type]
            **{f"tape {env}": tape for env, tape in self.tapes.items()},  # type: ignore[arg-type]
        )


def recorded(name: str, quantities: dict[str, np.ndarray], end: str) -> dict[str, Any]:
    """What the file keeps of an episode."""
    case: dict[str, Any] = {"end": end}
    for quantity, values in quantities.items():
        if quantity == "covariance":
            sd = deviations_of(values)
            case["sd"], values = sd.astype(np.float32), rows_of(values, sd)
        values = values.reshape(*values.shape[:2], -1)
        case[quantity], case[f"{quantity} range"] = sums_of(values), scale_of(values)
        if name.endswith("whole"):
            case[f"{quantity} steps"] = np.ascontiguousarray(values[::THIN, 0])
    return case


def compared(case: dict[str, Any], quantities: dict[str, np.ndarray], end: str) -> list[str]:
    """Sentences on what differs from the file."""
    found = [f"ends otherwise: {end}, not {case['end']}"] if end != case["end"] else []
    for quantity in QUANTITIES:
        if (quantity in case) != (quantity in quantities):
            found.append(f"{quantity}: {'missing' if quantity in case else 'new'}")
        if quantity not in case or quantity not in quantities:
            continue
        values = quantities[quantity]
        if quantity == "covariance":
            if values.shape[-1] != len(case["sd"]):
                found.append(f"covariance: {values.shape[-1]} components, not {len(case['sd'])}")
                continue
            values = rows_of(values, case["sd"].astype(float))
        values = values.reshape(*values.shape[:2], -1)
        scale = case[f"{quantity} range"].astype(float)
        if values.shape[-1] != len(scale):
            found.append(f"{quantity}: {values.shape[-1]} components, not {len(scale)}")
            continue
        share = _share(sums_of(values), case[quantity], scale).max(0)
        if not (share <= TOLERANCE).all():
            i, count = int(share.argmax()), int((share > TOLERANCE).sum())
            where = ""
            if f"{quantity} steps" in case:
                steps, before = values[::THIN, 0], case[f"{quantity} steps"]
                both = min(len(steps), len(before))
                off = (_share(steps[:both], before[:both], scale) > TOLERANCE).any(1)
                where = f", first seen at step {THIN * int(off.argmax())}" if off.any() else ""
            found.append(
                f"{quantity}[{i}]: {share[i]:.1e} of its range, {count} of {len(share)}"
                f" components{where}"
            )
    return found


def _share(now: np.ndarray, before: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Differences as shares of the ranges; infinite where one is not finite and the other is."""
    with np.errstate(invalid="ignore", over="ignore"):
        share = np.abs(now - before) / scale
    return np.where(
        (now == before) | (np.isnan(now) & np.isnan(before)),
        0.0,
        np.where(np.isnan(share), np.inf, share),
    )


# --- commands -------------------------------------------------------------------------------------


def record(only: list[str], fly: bool) -> int:
    """Write the file, or replace its part."""
    golden, refused = Golden(), {}
    if only and (differs := elsewhere(golden)):
        print(f"{differs}: record all, without --only")
        return 1
    if not only:
        golden.cases = {}
    golden.machine, tapes = machine(), {} if fly else dict(golden.tapes)
    for name, options in chosen(cases(), only):
        golden.cases.pop(name, None)
        env = name.split()[0]
        if env not in tapes:
            tapes[env] = flown(env)
        try:
            quantities, end = episode(name, options, tapes[env])
        except (ValueError, TypeError) as error:
            refused[name] = str(error)
            continue
        golden.cases[name] = recorded(name, quantities, end)
    golden.tapes |= tapes
    golden.cases = {name: golden.cases[name] for name, _ in cases() if name in golden.cases}
    golden.write()
    for name, sentence in refused.items():
        print(f"{name} is refused: {sentence[:160]}")
    print(
        f"{len(golden.cases)} cases in {FILE.stat().st_size / 1e3:.0f} kB; {len(refused)} refused"
    )
    return 0


def compare(only: list[str]) -> int:
    """Print what differs; 1 if anything does."""
    golden, planned, bad = Golden(), dict(cases()), 0
    if differs := elsewhere(golden):
        print(f"note: {differs}")
    names = chosen(((name, case) for name, case in golden.cases.items()), only)
    for name, case in names:
        if name not in planned:
            found = ["gone: no case of this script"]
        else:
            try:
                found = compared(case, *episode(name, planned[name], golden.tapes[name.split()[0]]))
            except Exception as error:
                found = [f"gone: {type(error).__name__}: {str(error)[:300]}"]
        bad += bool(found)
        for sentence in found:
            print(f"{name:60} {sentence}", flush=True)
    print(f"{len(names)} cases, {bad} differ")
    return int(bad > 0 or not names)


def elsewhere(golden: Golden) -> str:
    """A sentence on how this machine differs from that of the file; empty if it does not."""
    here = machine()
    other = [
        f"{key} {here.get(key)}, not {value}"
        for key, value in golden.machine.items()
        if here.get(key) != value
    ]
    return f"recorded on another machine: here is {'; '.join(other)}" if other else ""


def chosen(pairs: Any, only: list[str]) -> list[tuple[str, Any]]:
    """The cases whose names have one of some texts in them."""
    return [
        (name, value) for name, value in pairs if not only or any(text in name for text in only)
    ]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--record", action="store_true", help="write the file")
    parser.add_argument("--fly", action="store_true", help="let the autopilots give new actions")
    parser.add_argument(
        "--only",
        nargs="+",
        default=[],
        metavar="TEXT",
        help="cases with one of these in their names",
    )
    arguments = parser.parse_args()
    return record(arguments.only, arguments.fly) if arguments.record else compare(arguments.only)


if __name__ == "__main__":
    sys.exit(main())
