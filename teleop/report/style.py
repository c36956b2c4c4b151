"""How a page looks: light or dark as its reader's system is, and black on white on paper, A4 or letter.

The colours are those of `teleop.terminal.plotting`, of Okabe and Ito, which colour-blind eyes tell apart; on dark the
lighter ones of them.
"""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256

from teleop.terminal.plotting import BLUE, BROWN, GREEN, ORANGE, PALE, PINK, PURPLE, RED, SKY, YELLOW

LEVELS = 20  # colours of a map of numbers, `a0` to `a19`: viridis
_VIRIDIS = ((68, 1, 84), (72, 40, 120), (62, 73, 137), (49, 104, 142), (38, 130, 142), (31, 158, 137), (53, 183, 121),
            (110, 206, 88), (181, 222, 43), (253, 231, 37))
LINES = ("m", "s", "e", "g", "p0", "p1", "p2")  # classes: master, slave, hand and environment, link, and others
STATUS = {"ok": "aok", "limit cycle": "acycle", "unstable": "aunstable", "unsettled": "acycle", "diverged": "adiverged",
          "none ended ok": "adiverged", "refused": "arefused"}  # classes of areas
OTHER = "aother"
_LIGHT = {"m": BLUE, "s": RED, "e": "#707070", "g": GREEN, "p0": PINK, "p1": ORANGE, "p2": PURPLE}
_DARK = {"m": SKY, "s": "#FF8A3D", "e": "#A8A8A8", "g": "#2BC79A", "p0": PINK, "p1": ORANGE, "p2": "#B79CF0"}
_AREAS = {"aok": SKY, "acycle": YELLOW, "aunstable": PURPLE, "adiverged": RED, "arefused": PALE, OTHER: BROWN}


def _variables(colours: dict[str, str], plain: str) -> str:
    return plain + "".join(f"--{name}:{colour};" for name, colour in colours.items())


def _level(i: int) -> str:
    at = i / (LEVELS - 1) * (len(_VIRIDIS) - 1)
    low = min(int(at), len(_VIRIDIS) - 2)
    return "#" + "".join(f"{round(a + (b - a) * (at - low)):02x}"
                         for a, b in zip(_VIRIDIS[low], _VIRIDIS[low + 1], strict=True))


_ON_LIGHT = _variables(_LIGHT, "--back:#fff;--ink:#1b1b1b;--soft:#5c5c5c;--rule:#d9d9d9;--grid:#e9e9e9;--good:#00724f;"
                               "--bad:#b53a00;")
_ON_DARK = _variables(_DARK, "--back:#15181c;--ink:#e6e6e6;--soft:#a3a3a3;--rule:#3a3f46;--grid:#2a2e34;--good:#3ddc9f;"
                             "--bad:#ff9a5c;")
CSS = f"""
:root{{color-scheme:light dark;{_ON_LIGHT}}}
@media (prefers-color-scheme:dark){{:root{{{_ON_DARK}}}}}
@media print{{:root{{color-scheme:light;{_ON_LIGHT}--ink:#000}}}}
*{{box-sizing:border-box}}
body{{margin:0 auto;padding:1.2rem;max-width:52rem;background:var(--back);color:var(--ink);
font:15px/1.45 system-ui,-apple-system,"Segoe UI",Roboto,"Liberation Sans",Arial,sans-serif}}
h1,h2,h3{{line-height:1.2;margin:0 0 .3rem}}h1{{font-size:1.5rem}}h2{{font-size:1.2rem;margin-top:1.6rem}}
h3{{font-size:1rem;margin-top:1.1rem}}p{{margin:.3rem 0}}
.sub,footer,figcaption{{color:var(--soft)}}.out{{font-size:1.05rem}}.out b{{margin-right:.4em}}
.good{{color:var(--good)}}.bad{{color:var(--bad)}}
figure{{margin:.5rem 0 0;break-inside:avoid}}figcaption{{font-size:.85em}}svg{{display:block;width:100%;height:auto}}
svg text{{font-size:10.5px;fill:var(--ink)}}svg text.b{{font-weight:600;font-size:11px}}
.grid,.f{{fill:none;stroke:var(--grid)}}.f{{stroke:var(--rule)}}.e{{fill:none;stroke:var(--soft);stroke-dasharray:3 3}}
path.l{{fill:none;stroke-width:12;stroke-linejoin:round;stroke-linecap:round}}
path.w{{stroke-width:26;stroke-opacity:.55}}
path.y{{stroke-dasharray:60 30;stroke-linecap:butt}}path.z{{stroke-dasharray:15 25;stroke-linecap:butt}}
.edge{{fill:none;stroke:#000;stroke-width:14}}.cross{{stroke:var(--bad);fill:none;stroke-width:14}}
circle{{stroke:var(--back);stroke-width:.6}}
{"".join(f"path.{name}{{stroke:var(--{name})}}circle.{name}{{fill:var(--{name})}}path.b{name}{{fill:var(--{name});"
         f"fill-opacity:.2}}" for name in LINES)}
{"".join(f".{name}{{fill:{colour}}}" for name, colour in _AREAS.items())}
{"".join(f".a{i}{{fill:{_level(i)}}}" for i in range(LEVELS))}
@media screen and (max-width:40rem){{figure{{overflow-x:auto}}svg{{min-width:36rem}}.even{{min-width:36rem}}}}
.scroll{{overflow-x:auto}}table{{border-collapse:collapse;margin:.6rem 0;font-size:.87em;break-inside:auto}}
caption,.cap{{text-align:left;font-weight:600;padding-bottom:.2rem}}
th,td{{text-align:left;vertical-align:top;padding:.12rem .9rem .12rem 0;border-top:1px solid var(--grid)}}
thead th{{border-top:0;vertical-align:bottom}}
th[scope=row]{{font-weight:400;color:var(--soft)}}th.n,td.n{{text-align:right;font-variant-numeric:tabular-nums}}
tr{{break-inside:avoid}}.small{{font-size:.82em}}td{{overflow-wrap:anywhere}}td.k{{white-space:nowrap}}
table.even{{width:100%;table-layout:fixed}}
dl{{display:flex;flex-wrap:wrap;gap:.1rem 1.2rem;margin:.4rem 0;font-size:.87em}}
dl div{{display:flex;gap:.4em;max-width:100%}}dt{{color:var(--soft)}}dd{{margin:0;overflow-wrap:anywhere;min-width:0}}
code,pre{{font:.87em/1.4 ui-monospace,SFMono-Regular,Menlo,Consolas,"Liberation Mono",monospace;overflow-wrap:anywhere}}
pre{{white-space:pre-wrap;margin:.4rem 0}}footer{{margin-top:1.4rem;font-size:.85em;border-top:1px solid var(--rule);
padding-top:.5rem}}
@page{{margin:12mm 13mm}}
@media print{{body{{padding:0;max-width:none;font-size:9.5pt;line-height:1.3}}h1{{font-size:15pt}}
h2,h3{{break-after:avoid}}.scroll{{overflow:visible}}*{{print-color-adjust:exact;-webkit-print-color-adjust:exact}}}}
"""
STYLE = CSS.replace("\n", "")
DIGEST = b64encode(sha256(STYLE.encode()).digest()).decode()  # by which the page allows this style and no other
