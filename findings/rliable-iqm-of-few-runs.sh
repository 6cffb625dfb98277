#!/usr/bin/env bash
# One would expect the interquartile mean to be that of the middle half of all scores. But the
# number left out at each end is rounded down: of 3 runs of one environment none, so that it is the
# mean, and one diverged run counts a third; of 7 runs the middle 71 % stay (rliable 1.2.0,
# aggregate_iqm, "25% trimmed mean", by scipy.stats.trim_mean). Hurts who reports the IQM of 3
# training runs of one environment as robust. Instead: make runs times environments a multiple of 4;
# with fewer show each run, or the mean with an interval over runs and seeds.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile numpy==2.4.6 scipy==1.17.1
"$folder/env/bin/pip" install -qq --no-compile --no-deps rliable==1.2.0  # its plots are not needed

"$folder/env/bin/python" - <<'EOF'
from importlib.metadata import version

import numpy as np
from rliable.metrics import aggregate_iqm


def middle_half(scores):  # scores that lie partly in the middle half count in part
    x = np.sort(np.ravel(scores))
    edges = np.arange(x.size + 1) / x.size
    inside = np.clip(edges[1:], 0.25, 0.75) - np.clip(edges[:-1], 0.25, 0.75)
    return float(inside @ x / 0.5)


def weights(runs):  # of the sorted scores in rliable's mean
    scores = np.arange(runs) * 10.0
    return [aggregate_iqm((scores + e)[:, None]) - aggregate_iqm(scores[:, None])
            for e in np.eye(runs)]


print("rliable", version("rliable"), "- scores of 0.8, but one run diverged to -9")
print("runs     rliable  middle half       mean   weights of the sorted scores")
for runs in range(3, 9):
    scores = np.full((runs, 1), 0.8)
    scores[-1] = -9.0
    three = aggregate_iqm(scores), middle_half(scores), scores.mean()
    print(f"{runs:4}", *(f"{x:11.3f}" for x in three), " ", np.round(weights(runs), 2))

three = np.array([[0.8], [0.8], [-9.0]])
assert np.isclose(aggregate_iqm(three), three.mean()), "three runs no longer give the mean"
assert aggregate_iqm(three) < middle_half(three) - 1.5
assert np.allclose(weights(7), [0, 0.2, 0.2, 0.2, 0.2, 0.2, 0]), "of seven runs others count"
EOF
