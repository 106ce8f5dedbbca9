"""``relnav report``: one self-contained HTML file on a study or a comparison."""

from __future__ import annotations

from pathlib import Path

import click

from relnav_graph.cli.shared import show_events, show_progress


@click.command("report")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--draw", multiple=True, metavar="NAME", help="Row of a pass to draw; may repeat.")
@click.option("--trust", is_flag=True, help="Let the scenario in OUT name modules to import.")
def command(out: Path, draw: tuple[str, ...], trust: bool) -> int:
    """Write OUT/report.html, of the folder that study, compare or smooth wrote with -o.

    The file needs nothing else: no network, no other file. It has the setting, the
    tables, the verdict, figures, the worst runs and where all of it came from. With the
    extra relnav-graph[report] figures can be zoomed, and the pass is seen in space.
    """
    show_events()
    from relnav_graph.report.contents import StudyContents, read_contents
    from relnav_graph.report.page import write_report

    show_progress(f"reading {out} ...")
    content = read_contents(out, trust)
    if isinstance(content, StudyContents) and content.worst:
        show_progress(f"making run {content.worst[0].run} again, the worst, and drawing ...")
    show_progress(f"wrote {write_report(content, out, draw)}")
    return 0
