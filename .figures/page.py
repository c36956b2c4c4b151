"""Makes page.webp, the moving picture of the first page, from the real page: `.venv/bin/python .figures/page.py`.

`teleop demo --page` runs, a Chromium without a window shows it, and a script drags the handle into the wall, turns the
delay up, and takes the law that shakes. Needs Chromium, websockets and pillow. `--fps` prints instead what
the page costs the browser: frames a second and the main thread's share over ten seconds, and what the server takes.
"""

from __future__ import annotations

import io
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from tests.browser import Browser, Page  # noqa: E402 - found by the path above

SIZE, WIDTH, MOST = (820, 560), 640, 300_000  # px of the window; px and bytes of the picture
RATE = 10  # frames a second
SET = """((id, value) => {
  const at = document.getElementById(id);
  at.value = value;
  at.dispatchEvent(new Event('input'));
  at.dispatchEvent(new Event('change'));
})"""


def slider(page: Page, name: str, value: float) -> None:
    """Put a slider to a value as if by hand."""
    page.evaluate(f"(at => {SET}(at.id, scale(at.one).of({value})))(document.getElementById('k_{name}'))")


def law(page: Page, name: str) -> None:
    page.evaluate(f"{SET}('law', {name!r})")


def calm(page: Page) -> None:
    """Before the picture: the hand is in free space, and the strips are full."""
    page.until("row !== null && row.t > 9")
    page.evaluate("steer([-.01])")
    page.until("Math.abs(row.xm[0] + .01) < .002 && Math.abs(row.xs[0] - row.xm[0]) < .002")


def safe(page: Page) -> bool:
    """True while an end is in its safe state, as it is between two laws."""
    return bool(page.evaluate("document.querySelector('#measured .safe') !== null || !row"))


def film(page: Page) -> list[tuple[float, bytes]]:
    """Pictures with their times (s), while the script below goes on; the film is cut where an end is safe."""
    def hand(a: float, b: float) -> Callable[[float], Any]:
        return lambda p: page.evaluate(f"steer([{a + (b - a) * p * p * (3 - 2 * p)}])")

    # From and to (s), and what is done, given the share of it that has passed.
    script: list[tuple[float, float, Callable[[float], Any]]] = [
        (0.4, 1.6, hand(-0.01, 0.058)),
        (2.6, 2.6, lambda _p: slider(page, "delay", 0.2)),
        (4.6, 4.6, lambda _p: law(page, "direct")),
    ]
    done: set[float] = set()
    shots: list[tuple[float, bytes]] = []
    start, cut, taken = time.monotonic(), 0.0, 0
    while (t := time.monotonic() - start) < 8.2 + min(cut, 30.0):
        for a, b, act in script:
            if t >= a and a not in done:
                share = min(1.0, (t - a) / (b - a)) if b > a else 1.0
                act(share)
                if share == 1.0:
                    done.add(a)
        before, shot = safe(page), page.screenshot(optimizeForSpeed=True)
        taken += 1
        time.sleep(max(0.0, taken / RATE - (time.monotonic() - start)))
        if before or safe(page):
            cut += time.monotonic() - start - t
        else:
            shots.append((t - cut, shot))
    return shots


def picture(shots: list[tuple[float, bytes]], path: Path) -> None:
    """Write the shots as an animated WebP of at most `MOST` bytes."""
    from PIL import Image

    height = round(SIZE[1] * WIDTH / SIZE[0])
    images = [Image.open(io.BytesIO(png)).convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS)
              for _t, png in shots]
    times = [t for t, _png in shots]
    lasts = [round(1e3 * (b - a)) for a, b in zip(times, [*times[1:], times[-1] + 1.2], strict=True)]
    for quality in (70, 55, 45, 35, 25, 18, 10):
        images[0].save(path, save_all=True, append_images=images[1:], duration=lasts, loop=0, quality=quality, method=4,
                       minimize_size=True)
        if path.stat().st_size < MOST:
            print(f"{path.name}: {path.stat().st_size} bytes, {len(images)} frames, {sum(lasts) / 1e3:.1f} s, "
                  f"quality {quality}")
            return
    raise SystemExit(f"even at the lowest quality it is {path.stat().st_size} bytes")


def cost(page: Page, server: int) -> None:
    """Print what the page costs over ten seconds; `server`: process id."""
    def busy() -> dict[str, float]:
        found = {one["name"]: one["value"] for one in page.call("Performance.getMetrics")["metrics"]}
        words = Path(f"/proc/{server}/stat").read_text().rpartition(")")[2].split()
        found["server"] = (int(words[11]) + int(words[12])) / 100.0
        found["frames"], found["now"] = page.evaluate("[frames, performance.now() / 1e3]")
        return found

    page.call("Performance.enable")
    calm(page)
    before = busy()
    time.sleep(10.0)
    after = busy()
    passed = after["now"] - before["now"]
    names = ("frames", "TaskDuration", "ScriptDuration", "server")
    share = {name: (after[name] - before[name]) / passed for name in names}
    print(f"{share['frames']:.1f} frames a second, main thread {share['TaskDuration']:.1%} (scripts "
          f"{share['ScriptDuration']:.1%}), server {share['server']:.1%} of a core")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        demo = subprocess.Popen([sys.executable, "-m", "teleop", "demo", "--page", "--out", f"{folder}/run"], cwd=ROOT,
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert demo.stdout is not None
        found = re.search(r"http://\S+", demo.stdout.readline())
        assert found is not None
        browser = Browser()
        try:
            page = browser.page(found.group(), width=SIZE[0], height=SIZE[1])
            if "--fps" in sys.argv:
                cost(page, demo.pid)
            else:
                calm(page)
                picture(film(page), Path(__file__).with_suffix(".webp"))
        finally:
            browser.close()
            demo.send_signal(signal.SIGINT)
            demo.communicate(timeout=60)


if __name__ == "__main__":
    main()
