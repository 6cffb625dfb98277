"""Words of neighbouring keys, steps and counters without end, for a battery of tests.

python -m tests.estimators.words | dieharder -a -g 200
"""

import sys
from itertools import count

import numpy as np

from estimators.threefry import derived

if __name__ == "__main__":
    keys = np.stack([np.arange(4096, dtype=np.uint64), np.zeros(4096, np.uint64)], -1)
    for step in count():
        blocks = derived(keys[:, None], np.arange(8, dtype=np.uint64), np.uint64(step << 16))
        sys.stdout.buffer.write(blocks.tobytes())
