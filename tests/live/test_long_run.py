"""What the end of a run of half an hour takes: 1.8 million rows, a record of 137 MB for each end."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from teleop.live.records.record import RecordWriter
from teleop.protocol.guard import Event
from teleop.scene.loading import load_scene
from teleop.simulation.structure import columns

TICKS = 1_800_000
SCENE = load_scene("hard_wall", duration=TICKS * 1e-3)

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
    """The folder of a run whose two ends were killed after half an hour."""
    top = tmp_path_factory.mktemp("long")
    about = {"scene": "hard_wall", "knobs": {"duration": f"{TICKS * 1e-3}"}, "seed": 0, "mode": "live", "command": []}
    for e, name in (("m", "master"), ("s", "slave")):
        (top / name).mkdir()
        recorder = RecordWriter(SCENE, e, top / name, about)
        recorder.begin("bodies")
        recorder.note(Event(0, "met", "session 1"))
        width = len(columns(SCENE, e))
        for k in range(TICKS):
            if k % 1000:  # now and then one is left out
                recorder.add(k, 1000 + k % 77, k - 50 if k >= 50 else -1, (0.01 * math.sin(1e-3 * k),) * width)
        recorder.close()
    return top


def peak_mb(folder: Path) -> int:
    done = subprocess.run([sys.executable, "-c", CHILD, str(folder)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return int(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems tell the peak otherwise")
@pytest.mark.parametrize(("inside", "most"), [("master", 170), ("slave", 170), ("", 250)])
def test_the_end_of_half_an_hour_took_more_than_a_gigabyte(run: Path, inside: str, most: int) -> None:
    """1,285 MB for a master, 1,119 MB for a slave, 1,964 MB for both put together."""
    taken = peak_mb(run / inside)
    told = json.loads((run / inside / "summary.json").read_text())
    assert told["ticks"] == TICKS - TICKS // 1000
    assert told["metrics"]["f_m_max" if inside != "slave" else "f_s_max"]["value"] == pytest.approx(0.01)
    assert taken < most
