"""What the end of a run of nearly four minutes takes: 225 thousand rows, a record of 17 MB for each end."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from teleop.protocol.guard import Event
from tests.live.recording import record_of

TICKS = 225_000

CHILD = """
import sys
from pathlib import Path
from teleop.live.records.merge import recover
recover(Path(sys.argv[1]))
peak = [line for line in open("/proc/self/status") if line.startswith("VmHWM:")]  # of this program alone, unlike rusage
print(int(peak[0].split()[1]) // 1024)
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run whose two ends were killed after nearly four minutes."""
    top = tmp_path_factory.mktemp("long")
    ticks = [k for k in range(TICKS) if k % 1000]  # now and then one is left out
    for e, name in (("m", "master"), ("s", "slave")):
        record_of(top / name, e, ticks, events=[Event(0, "met", "session 1")], duration=f"{TICKS * 1e-3}",
                  row=lambda k: (1000 + k % 77, k - 50 if k >= 50 else -1, 0.01 * math.sin(1e-3 * k))).close()
    return top


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="other systems tell the peak otherwise")
def test_the_end_of_half_an_hour_took_more_than_a_gigabyte(run: Path) -> None:
    """1,285 MB for a master, 1,119 MB for a slave, 1,964 MB for both; later 389 MB for both, all columns at once.

    An eighth of that run needs an eighth of it above an interpreter's 40 MB: 195, 175, 280, and later 84 MB.
    """
    for inside, most in ("master", 68), ("slave", 66), ("", 74):
        done = subprocess.run([sys.executable, "-c", CHILD, str(run / inside)], capture_output=True, text=True,
                              check=False)
        assert done.returncode == 0, done.stderr
        told = json.loads((run / inside / "summary.json").read_text())
        assert told["ticks"] == TICKS - TICKS // 1000
        assert told["metrics"]["f_m_max" if inside != "slave" else "f_s_max"]["value"] == pytest.approx(0.01)
        assert int(done.stdout) < most, inside
