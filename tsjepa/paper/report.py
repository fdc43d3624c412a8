"""``tsjepa report``: every figure beside what the paper claims, with a verdict on each claim; Markdown and HTML."""

from __future__ import annotations

import base64
import html
import os
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from tsjepa.paper import FIGURES, module_of, store
from tsjepa.paper.claims import CLAIMS, NOT, PARTLY, REPRODUCED, UNMEASURED, Claim, Verdict
from tsjepa.paper.command import RESULTS, points_of, recipe_settings, redraw
from tsjepa.paper.sweep import all_weights
from tsjepa.support.files import write_text

HEAD = (
    "What the paper claims (Girgis, Valcarce, Bennis: Time-Series JEPA for Predictive Remote Control under "
    "Capacity-Limited Networks) beside what this repository measures. Every figure is drawn from the recorded results "
    "in docs/results/figures, whose every row names its seed, commit and command. `make figures` draws them again, "
    "`make figures-check` repeats a point of each, `make report` writes this page."
)
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
.wide { overflow-x: auto; } p, li { overflow-wrap: anywhere; }
th, td { border: 1px solid #ccc; min-width: 5rem; padding: .35rem .5rem; text-align: left; vertical-align: top; }
th { background: #f3f3f3; } img { max-width: 100%; height: auto; } code { background: #f3f3f3; }
.reproduced { background: #dff2df; } .partly { background: #fff3cf; } .not { background: #f8d9d6; }
.not-measured { background: #eee; }
@media (max-width: 40rem) { /* a claim is a card, its cells below each other */
  .wide table, .wide tbody, .wide tr, .wide td { display: block; font-size: 15px; }
  .wide tr { margin-bottom: .75rem; border: 1px solid #ccc; } .wide tr:first-child, .wide td:empty { display: none; }
  .wide td { border: 0; padding: .2rem .6rem; overflow-wrap: anywhere; } .wide td:nth-child(3) { font-weight: bold; }
  .wide td:nth-child(1) { color: #555; }
}
"""


def report(output: str = "docs/results", results: str = RESULTS) -> dict[str, str]:
    """Writes report.md and report.html, which holds its pictures itself.

    Args:
        output: folder of the page.
        results: folder of the recorded results and their pictures.

    Returns:
        The verdict on every claim, by its name.
    """
    claimed = [name for name in FIGURES if any(claim.figure == name for claim in CLAIMS.values())]
    modules = {name: module_of(name) for name in claimed}
    records = {name: store.read(results, name) for name in claimed}
    for module in modules.values():
        redraw(module, results)
    verdicts = judged(modules, records)
    folder = Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "report.md", markdown(modules, records, verdicts, os.path.relpath(results, folder)))
    write_text(folder / "report.html", page(modules, records, verdicts, Path(results)))
    print(f"{folder / 'report.md'} and {folder / 'report.html'}: {tally(verdicts)}")
    return {name: verdict.verdict for name, verdict in verdicts.items()}


def judged(modules: dict[str, ModuleType], records: dict[str, list[dict]]) -> dict[str, Verdict]:
    """A verdict for every claim; "not measured" where the results it needs are not recorded.

    A verdict from a sweep that is not finished says so.
    """
    found = {}
    for name, module in modules.items():
        new = module.verdicts(records[name]) if records[name] else {}
        whole = len(points_of(module, recipe_settings(name)))
        if len(records[name]) < whole:
            note = f"so far, from {len(records[name])} of {whole} points of the sweep: "
            new = {key: replace(verdict, ours=note + verdict.ours) for key, verdict in new.items()}
        found |= new
    return {name: found.get(name) or unmeasured(claim, records[claim.figure]) for name, claim in CLAIMS.items()}


def unmeasured(claim: Claim, records: list[dict]) -> Verdict:
    """What to run for a claim that has no results yet."""
    what = "the models or points that it needs are not recorded" if records else "nothing is recorded"
    command = f"`tsjepa figures --config recipes/figures/{claim.figure}.yaml --recompute true`"
    return Verdict(UNMEASURED, "", f"{what} yet: {command}")


def tally(verdicts: dict[str, Verdict]) -> str:
    """How many claims came out how."""
    said = [verdict.verdict for verdict in verdicts.values()]
    counts = [f"{said.count(kind)} {kind}" for kind in (REPRODUCED, PARTLY, NOT, UNMEASURED) if kind in said]
    return f"{len(said)} claims, {', '.join(counts)}."


def summary(modules: dict[str, ModuleType], verdicts: dict[str, Verdict]) -> list[str]:
    """One line a figure: how many of its claims came out how."""
    lines = []
    for name, module in modules.items():
        said = [verdicts[key].verdict for key, claim in CLAIMS.items() if claim.figure == name]
        counts = [f"{said.count(kind)} {kind}" for kind in (REPRODUCED, PARTLY, NOT, UNMEASURED) if kind in said]
        lines.append(f"{module.TITLE}: {', '.join(counts) or 'no claim'}.")
    return lines


def alternative(module: ModuleType) -> str:
    """What a picture shows, for those who do not see it."""
    return f"{module.TITLE}: {module.draw.__doc__.splitlines()[0]}"


def origins(records: list[dict]) -> list[str]:
    """The commands that made the results, with commit, date, what has changed since, and number of points."""
    counts: dict[str, int] = {}
    for record in records:
        made = record["made_by"]
        restated = f"; restated: {made['restated']}" if "restated" in made else ""
        changed = "" if record["weights"] == all_weights(record["point"]) else "; by other weights or recipes than here"
        line = f"`{made['command']}` (commit {made['commit']}, {made['date']}{restated}{changed})"
        counts[line] = counts.get(line, 0) + 1
    return [f"{line}: {count} point{'s' * (count > 1)}" for line, count in counts.items()]


def markdown(modules: dict, records: dict, verdicts: dict[str, Verdict], pictures: str) -> str:
    """The page as Markdown; pictures are links."""
    lines = ["# The paper's figures, ours beside them", "", HEAD, "", "## In short", ""]
    lines += [*(f"- {line}" for line in summary(modules, verdicts)), "", "## Verdicts", "", tally(verdicts), ""]
    lines += ["| source | the paper's claim | verdict | our figures | reason |", "|---|---|---|---|---|"]
    for name, claim in CLAIMS.items():
        verdict = verdicts[name]
        lines.append(f"| {claim.source} | {claim.text} | **{verdict.verdict}** | {verdict.ours} | {verdict.reason} |")
    for name, module in modules.items():
        lines += ["", f"## {module.TITLE}", ""]
        if not records[name]:
            lines += [f"Nothing recorded yet: `tsjepa figures --config recipes/figures/{name}.yaml --recompute true`."]
            continue
        lines += [f"![{alternative(module)}]({pictures}/{name}.png)", "", module.CAPTION, ""]
        lines += [
            f"- *{claim.text}* **{verdicts[key].verdict}**: {explained(verdicts[key])}"
            for key, claim in CLAIMS.items()
            if claim.figure == name
        ]
        lines += [
            "",
            f"Results: [{name}.csv]({pictures}/{name}.csv), [{name}.json]({pictures}/{name}.json). Made by:",
            "",
        ]
        lines += [f"- {line}" for line in origins(records[name])]
    return "\n".join(lines) + "\n"


def page(modules: dict, records: dict, verdicts: dict[str, Verdict], pictures: Path) -> str:
    """The page as one HTML file that needs no other."""
    body = [
        f"<h1>The paper's figures, ours beside them</h1><p>{code(HEAD)}</p><h2>In short</h2><ul>",
        *(f"<li>{code(line)}</li>" for line in summary(modules, verdicts)),
        f"</ul><h2>Verdicts</h2><p>{tally(verdicts)}</p>",
    ]
    body.append('<div class="wide"><table>')
    body.append("<tr><th>source<th>the paper's claim<th>verdict<th>our figures<th>reason</tr>")
    for name, claim in CLAIMS.items():
        verdict = verdicts[name]
        cells = [claim.source, claim.text, verdict.verdict, verdict.ours, verdict.reason]
        kind = verdict.verdict.replace(" ", "-")
        body.append(f'<tr class="{kind}">' + "".join(f"<td>{code(cell)}" for cell in cells) + "</tr>")
    body.append("</table></div>")
    for name, module in modules.items():
        body.append(f'<h2 id="{name}">{html.escape(module.TITLE)}</h2>')
        if not records[name]:
            body.append("<p>Nothing recorded yet.</p>")
            continue
        picture = base64.b64encode((pictures / f"{name}.png").read_bytes()).decode()
        body.append(f'<img alt="{html.escape(alternative(module))}" src="data:image/png;base64,{picture}">')
        body.append(f"<p>{code(module.CAPTION)}</p><ul>")
        for key, claim in CLAIMS.items():
            if claim.figure == name:
                verdict = verdicts[key]
                body.append(f"<li><i>{code(claim.text)}</i> <b>{verdict.verdict}</b>: {code(explained(verdict))}")
        body.append("</ul><p>Made by:</p><ul>" + "".join(f"<li>{code(line)}" for line in origins(records[name])))
        body.append("</ul>")
    title = "The paper's figures, ours beside them"
    meta = '<meta charset="utf-8"><meta name="viewport" content="width=device-width">'
    head = f"{meta}<title>{title}</title><style>{STYLE}</style>"
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n' + "\n".join(body) + "\n</body></html>\n"


def explained(verdict: Verdict) -> str:
    """Our figures and the reason, of which either may be missing."""
    return "; ".join(part for part in (verdict.ours, verdict.reason) if part)


def code(text: str) -> str:
    """Text for HTML, with what stands between backticks as code."""
    parts = html.escape(text).split("`")
    return "".join(f"<code>{part}</code>" if index % 2 else part for index, part in enumerate(parts))
