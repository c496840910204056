"""The index page: plain HTML beside the pictures, readable offline, in light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from base_station.evaluation.thesis.comparison import WITHIN_PX, Tally
from base_station.evaluation.thesis.plotting import Plate

_STYLE = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #20242c; --soft: #5b6472; --line: #dcdfe6; --tint: #f5f6f9;
  --link: #1f6fb4; --good: #e3f3e9; --bad: #fae5e2; }
@media (prefers-color-scheme: dark) { :root { --paper: #171b22; --ink: #e4e7ed; --soft: #a2a9b6; --line: #343a46;
  --tint: #1f242d; --link: #6db3f2; --good: #1d3a2a; --bad: #45231f; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, "DejaVu Sans", sans-serif; }
main, header { max-width: 62rem; margin: 0 auto; padding: 0 1.25rem; }
header { padding-top: 2.5rem; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .5rem; }
h2 { font-size: 1.3rem; margin: 3rem 0 1rem; padding-top: 1rem; border-top: 1px solid var(--line); }
h3 { font-size: 1.05rem; margin: 2.2rem 0 .6rem; }
a { color: var(--link); }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; }
dl { display: grid; grid-template-columns: 7.5rem 1fr; gap: .35rem 1rem; margin: .8rem 0; }
dt { color: var(--soft); }
dd { margin: 0; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .88rem; margin: .6rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .7rem; text-align: left; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; }
td.number { text-align: right; white-space: nowrap; }
td.good { background: var(--good); }
td.bad { background: var(--bad); }
code, pre { font: .88rem/1.5 ui-monospace, "DejaVu Sans Mono", monospace; }
pre { background: var(--tint); padding: .8rem 1rem; overflow-x: auto; border-radius: 6px; }
nav ul { columns: 16rem; column-gap: 2.5rem; padding-left: 1.1rem; font-size: .92rem; }
footer { color: var(--soft); font-size: .88rem; margin: 3rem 0 2rem; }
@media (max-width: 40rem) { dl { grid-template-columns: 1fr; gap: 0; } dt { margin-top: .5rem; } }
"""


def page(
    sections: Sequence[tuple[str, Sequence[Plate]]],
    results: dict[str, dict[str, Tally]],
    facts: dict[str, str],
    *,
    dark: bool,
) -> str:
    """The whole page. `sections`: heading and figures; `results`: case -> tracker -> tally; `facts`: about the run;
    `dark`: there is a dark twin of every figure."""
    links = "".join(
        f'<li><a href="#{plate.name}">{escape(plate.title)}</a></li>' for _, plates in sections for plate in plates
    )
    told = "".join(
        f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in facts.items() if name != "command"
    )
    body = "".join(
        f"<h2>{escape(heading)}</h2>" + "".join(_figure(plate, dark) for plate in plates)
        for heading, plates in sections
    )
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The thesis's figures, reproduced</title>
<style>{_STYLE}</style>
</head>
<body>
<header>
<h1>The thesis's figures, reproduced</h1>
<p>F. Khalil, master's thesis, Paris 2021: the Z-transform as a low-cost way for a robot to see how a picture moved. Its
figures are known here by their captions and text; each is repeated as an experiment with numbers, and where the
algorithm failed, the cause is shown by itself.</p>
<pre>{escape(facts["command"])}</pre>
<dl>{told}</dl>
<nav aria-label="Figures"><ul>{links}<li><a href="#table">The comparison as a table</a></li></ul></nav>
</header>
<main>
{body}
<h2 id="table">The comparison as a table</h2>
<p>Per case: median error in px (of the frames answered), and the share of all frames that were right (within
{WITHIN_PX} px), wrong, or without an answer (LOST, no bearing, or refused to learn).</p>
{_table(results)}
<footer>Made by scripts/reproduce-thesis. The derivation stands in base_station/trackers/ztransform/README.md.</footer>
</main>
</body>
</html>
"""


def _figure(plate: Plate, dark: bool) -> str:
    width, height = (round(100 * inches) for inches in plate.size_in)
    twin = f'<source media="(prefers-color-scheme: dark)" srcset="{plate.name}-dark.png">' if dark else ""
    numbers = ""
    if plate.numbers:
        rows = "".join(
            f'<tr><td>{escape(name)}</td><td class="number">{escape(value)}</td></tr>' for name, value in plate.numbers
        )
        numbers = f'<div class="wide"><table><tbody>{rows}</tbody></table></div>'
    return f"""
<section id="{plate.name}">
<h3>{escape(plate.title)}</h3>
<figure><picture>{twin}
<img src="{plate.name}.png" width="{width}" height="{height}" alt="{escape(plate.alt)}"></picture></figure>
<dl><dt>The thesis</dt><dd>{escape(plate.thesis)}</dd><dt>Here</dt><dd>{escape(plate.ours)}</dd></dl>
{numbers}
</section>
"""


def _table(results: dict[str, dict[str, Tally]]) -> str:
    cases, names = list(results), list(next(iter(results.values())))
    head = "".join(f"<th>{escape(case)}</th>" for case in cases)
    rows = ""
    for name in names:
        cells = "".join(_cell(results[case][name], nothing_to_see="wall" in case) for case in cases)
        rows += f"<tr><th>{escape(name)}</th>{cells}</tr>"
    return f'<div class="wide"><table><thead><tr><th>tracker</th>{head}</tr></thead><tbody>{rows}</tbody></table></div>'


def _cell(tally: Tally, *, nothing_to_see: bool) -> str:
    right, wrong, none = tally.share("right"), tally.share("wrong"), tally.share("lost") + tally.share("refused")
    median = f"{np.median(tally.errors_px):.2f} px" if tally.errors_px else "no answer"
    good = wrong == 0 if nothing_to_see else right >= 0.98
    kind = "good" if good else "bad" if wrong > 0.05 else ""
    shares = f"{100 * right:.0f} % right<br>{100 * wrong:.0f} % wrong<br>{100 * none:.0f} % none"
    return f'<td class="{kind}">{median}<br>{shares}</td>'
