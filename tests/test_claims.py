"""Every number that README, findings, the environments' pages and that of agents state is traced in docs/claims.csv."""

import ast
import csv
import re
from importlib.util import find_spec
from inspect import signature
from pathlib import Path

import gymnasium as gym
import pytest

from agents import rollout
from agents.commands import COMMANDS
from studies.markdown import around
from studies.tables import BLOCKS

ROOT = Path(__file__).parents[1]
WALKED = [
    *("README.md", "docs/findings.md", "docs/agents.md"),
    *sorted(f"docs/environments/{page.name}" for page in (ROOT / "docs/environments").glob("*.md")),
]
CLAIMS = list(csv.DictReader((ROOT / "docs/claims.csv").read_text(encoding="utf-8").splitlines()))
LEFT_OUT = re.compile(
    r"<!-- (?:table|text): .*?<!-- end -->"  # what a command writes
    r"|^\s*```.*?^\s*```|^\|.*?$|^\s*:\w+:.*?$|!\[.*?\]\([^)]*\)",  # code, tables, pictures
    re.S | re.M,
)
CODE_OR_ADDRESS = re.compile(r"`[^`]*`|\]\([^)]*\)")
COUNT = (
    "(?:two|three|four|five|six|seven|eight|nine|ten|eleven|twelve|fifteen|twenty|fifty|hundred)"
)
NUMBER = re.compile(
    r"(?<![\w.,-])[-−±]?\.?(?!(?:19|20)\d\d\))\d"  # years in parentheses are references
    rf"|\b{COUNT}(?:-?fold| (?:times|minutes|hours|points|in|of|out|per)\b(?!\]))"
    r"|\b(?:times|twice|thrice|doubled?|half|per ?cent)\b"
    r"|\ba (?:third|quarter|fifth|tenth|hundredth)\b",
    re.I,
)
TEXT = {
    page: (ROOT / page).read_text(encoding="utf-8")
    for page in {*WALKED, *(row["page"] for row in CLAIMS)}
}


def joined(text: str) -> str:
    return " ".join(text.split())


def untraced(page: str, text: str) -> list[str]:
    """Numbers of a page that no command writes and no claim has, with what stands about them."""
    rest = joined(LEFT_OUT.sub("", text))
    for row in CLAIMS:
        if row["page"] == page:
            rest = rest.replace(joined(row["claim"]), "§")
    rest = CODE_OR_ADDRESS.sub("]", rest)
    return [rest[max(found.start() - 40, 0) : found.end() + 30] for found in NUMBER.finditer(rest)]


@pytest.mark.parametrize("page", WALKED)
def test_every_number_of_a_page_is_traced(page: str):
    assert set(re.findall(r"^<!-- (?:table|text): (.*) -->$", TEXT[page], re.M)) <= set(BLOCKS)
    assert untraced(page, TEXT[page]) == []


@pytest.mark.parametrize(
    "sentence",
    [
        "It scores 0.123 more.", "It loses 12 % of it.", "It is three times as large.", "PPO wins in 7 of 10 runs.",
        "It wins seven of ten.", "It takes nine minutes of CPU time.", "The difference is −0.03.", "It errs by half.",
        "- It is .5 better", "It takes\n40 s.", "Its share is 1e-3.", "A tenfold gain.", "It gained 3 points (2.5).",
    ],
)  # fmt: skip
def test_a_new_sentence_with_a_number_is_found(sentence: str):
    for page in WALKED:
        assert untraced(page, f"{TEXT[page]}\n\n{sentence}\n"), page


def numbers(text: str) -> set[float]:
    return {
        float(found.replace(",", ""))
        for found in re.findall(r"\d[\d,]*(?:\.\d+)?(?:e-?\d+)?", text)
    }


def source(command: str) -> str | None:
    """What a command's numbers stand in: the table that it writes, or the file of a setting; else None."""
    kind, _, rest = command.partition(" ")
    if kind == "studies.tables":
        page, mark, _ = BLOCKS[rest]
        before, after = around(page, mark)
        return page.read_text(encoding="utf-8")[len(before) : -len(after)]
    return (ROOT / rest).read_text(encoding="utf-8") if kind == "setting" else None


@pytest.mark.parametrize("row", CLAIMS, ids=[row["claim"][:40] for row in CLAIMS])
def test_a_claim_stands_in_its_page_and_follows_from_a_command(row: dict[str, str]):
    assert joined(row["claim"]) in joined(TEXT[row["page"]])
    assert len(row["claim"].split()) >= 3
    assert row["seeds"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", row["date"])
    command = row["command"]
    match command.split():
        case ["studies.tables" | "setting", *_]:
            assert numbers(row["claim"]) <= numbers(source(command))
        case ["vessel-gym", "ablate", study]:
            assert (ROOT / f"studies/{study}.toml").is_file()
        case ["vessel-gym", name, env_id, *_]:
            assert name in COMMANDS
            assert env_id in gym.registry
        case ["make", target]:
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M)
        case ["python", "-m", module, *_]:
            assert find_spec(module)
        case _:
            call = ast.parse(command, mode="eval").body
            assert call.func.id == "rollout"
            assert signature(rollout).bind(*call.args).arguments["env_id"].value in gym.registry
