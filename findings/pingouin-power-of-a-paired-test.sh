#!/usr/bin/env bash
# One would expect the "achieved power" of a paired t-test to be that of the paired test. But it
# comes from Cohen's d by the scores' own deviation, not by that of the differences, which its
# formula needs: a test with T = -16 has a "power" of 0.24 (pingouin 0.7.0, ttest(paired=True),
# whose notes do not say so). Hurts who compares estimators on common seeds and plans their number
# by it: 93 seeds where 3 do. Instead: compute_effsize(..., paired=True, eftype="cohen_dz") for
# power_ttest, or simulate.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/env"
"$folder/env/bin/pip" install -qq --no-compile pingouin==0.7.0 pandas==2.3.3 \
    numpy==2.4.6 scipy==1.17.1

"$folder/env/bin/python" -W ignore - <<'EOF'
from importlib.metadata import version

import numpy as np
import pingouin as pg
from scipy.stats import ttest_rel

rng = np.random.default_rng(0)


def study(seeds):  # scores of two filters: the weather of a seed is the same for both
    weather = rng.normal(0.6, 0.1, seeds)
    return weather, weather + 0.025 + rng.normal(0, 0.01, seeds)


a, b = study(20)
result = pg.ttest(a, b, paired=True).iloc[0]
dz = pg.compute_effsize(a, b, paired=True, eftype="cohen_dz")
repeated = np.mean([ttest_rel(*study(20)).pvalue < 0.05 for _ in range(2000)])
power = pg.power_ttest(d=dz, n=20, contrast="paired")
planned = [pg.power_ttest(d=abs(d), power=0.8, contrast="paired") for d in (result.cohen_d, dz)]

print("pingouin", version("pingouin"))
print(f"T {result['T']:.2f}, p {result.p_val:.1e}, Cohen's d {result.cohen_d:.3f}, d_z {dz:.2f}")
print(f"power as reported {result.power:.3f}, by d_z {power:.3f}, simulated {repeated:.3f}")
print(f"seeds for a power of 0.8: by d {planned[0]:.0f}, by d_z {planned[1]:.1f}")

assert result.power < 0.4 and repeated > 0.99, "the reported power is right now"
assert abs(power - repeated) < 0.01
assert planned[0] > 20 * planned[1]
EOF
