"""Claims on fresh seeds: confirmed, not confirmed or contradicted, and opened once."""

from dataclasses import replace

import pytest
from invented import CONDITIONS, CORVETTE, LEARNED, QUALITY, results, study

from agents.commands import ablate
from agents.seeds import evaluation_seeds
from agents.studies.answer import answer
from agents.studies.confirmation import CONFIRMED, FAILED, OPEN, confirmed, is_open, open_seeds
from agents.studies.plan import plan
from agents.studies.records import Confirmation
from agents.studies.report import page, write_report

STUDY = replace(study((CORVETTE,), conditions=CONDITIONS[:1]), confirm=Confirmation(500, 40))


@pytest.fixture(scope="module")
def first():
    return results(STUDY)


def fresh(**quality):
    return results(STUDY.fresh, QUALITY | {name.replace("_", "-"): value for name, value in quality.items()})


def test_the_same_arms_fly_seeds_that_the_study_does_not(first):
    again = plan(STUDY.fresh)
    assert again.study.seeds == evaluation_seeds(40, 500)
    assert not set(again.study.seeds) & set(STUDY.seeds)
    arms = [[(f.environment, f.condition, f.agent, f.flown_on) for f in p.flights] for p in (first.plan, again)]
    assert arms[0] == arms[1]
    seeds = {(f.job.arguments["first_seed"], f.job.arguments["episodes"]) for f in again.flights}
    assert seeds == {(500, 40)}


def test_policies_are_not_trained_again_for_a_confirmation():
    learned = replace(STUDY, agents=LEARNED, training_seeds=1)
    trained = [{need.key for f in plan(s).flights for need in f.job.needs} for s in (learned, learned.fresh)]
    assert trained[0] == trained[1]
    assert len(trained[0]) == 4


def test_a_claim_is_confirmed_by_the_same_verdict_and_contradicted_by_another(first):
    def outcomes(**quality):
        return {claim.first.one: claim.outcome for claim in confirmed(first, fresh(**quality)).claims}

    assert outcomes() == {"enkf": CONFIRMED, "ekf": CONFIRMED, "kf": CONFIRMED}
    assert outcomes(enkf=1.2) == {
        "enkf": FAILED,
        "ekf": CONFIRMED,
        "kf": CONFIRMED,
    }  # of worse than kf-umv-ui it is better
    assert outcomes(ekf=0.95)["ekf"] in (OPEN, FAILED)  # as good as the best


def test_the_answer_and_the_report_say_what_was_confirmed(first, tmp_path):
    again = fresh(enkf=1.2)
    told = " ".join(answer(first, again))
    assert "On 40 fresh evaluation seeds, opened once, kf-umv-ui keeps 0.9" in told
    assert "2 of 3 claims of the first seeds are confirmed; contradicted: enkf worse than kf-umv-ui" in told
    (table,) = (t for t in page(first, tmp_path, again).tables if t.name == "confirmation")
    [(column, rows)] = table.sections
    assert column == CORVETTE
    assert {name: str(entries[-1]) for name, entries in rows} == {
        "enkf − kf-umv-ui": FAILED, "ekf − kf-umv-ui": CONFIRMED, "kf − kf-umv-ui": CONFIRMED,
    }  # fmt: skip
    assert "confirm" not in " ".join(answer(first))


def test_what_the_first_seeds_leave_open_is_no_claim_that_fresh_seeds_could_confirm():
    level = dict.fromkeys(QUALITY, 0.9) | {"truth": 1.0, "dead-reckoning": 0.0}
    found = confirmed(results(STUDY, level), fresh())
    assert [claim.outcome for claim in found.claims if claim.verdicts[0] == "not decided"].count("") > 0


@pytest.mark.slow
def test_episodes_of_both_passes_and_the_answer_are_written(first, tmp_path):
    again = fresh()
    write_report(first, tmp_path, again)
    lines = [len((tmp_path / name).read_text().splitlines()) for name in ("episodes.csv", "confirmation.csv")]
    assert lines == [1 + n * len(first.plan.flights) for n in (8, 40)]
    assert (tmp_path / "answer.md").read_text().split() == " ".join(answer(first, again)).split()


def test_fresh_seeds_are_opened_once_for_one_study(tmp_path):
    assert not is_open(STUDY, tmp_path)
    open_seeds(STUDY, tmp_path)
    record = (tmp_path / "confirmation.json").read_bytes()
    open_seeds(replace(STUDY, title="in other words"), tmp_path)
    assert (tmp_path / "confirmation.json").read_bytes() == record
    assert is_open(STUDY, tmp_path)
    for other in (
        replace(STUDY, confirm=Confirmation(900, 40)),
        replace(STUDY, estimators=STUDY.estimators[:-1]),
        replace(STUDY, margin=0.1),
    ):
        assert not is_open(other, tmp_path)
        with pytest.raises(ValueError, match="opened once"):
            open_seeds(other, tmp_path)


def test_a_damaged_record_of_what_was_opened_is_one_sentence(tmp_path):
    for text in ("", "[]", '{"opened": 1}'):
        (tmp_path / "confirmation.json").write_text(text)
        with pytest.raises(ValueError, match="damaged"):
            open_seeds(STUDY, tmp_path)


@pytest.mark.slow
def test_the_command_opens_fresh_seeds_when_asked_and_reports_them_from_then_on(tmp_path, capsys):
    text = "episodes = 2\nconfirm = { first_seed = 10, episodes = 3 }\n[environments]\nSigmaCorvette-v0 = {}\n"
    path, out = tmp_path / "small.toml", tmp_path / "out"
    path.write_text(text + "[estimators]\nkf = {}\n")
    assert ablate.main(path, out, processes=1, confirm=True) == 0
    assert "3 fresh evaluation seeds" in capsys.readouterr().out
    seeds = {int(row.split(",")[6]) for row in (out / "confirmation.csv").read_text().splitlines()[1:]}
    assert seeds == set(evaluation_seeds(3, 10))
    assert ablate.main(path, out, processes=1) == 0
    assert "3 fresh evaluation seeds" in capsys.readouterr().out
    path.write_text(text + "[estimators]\nekf = {}\n")
    with pytest.raises(ValueError, match="opened once"):
        ablate.main(path, out, processes=1, confirm=True)
