"""``python -m relnav_graph``: the command line."""

from __future__ import annotations

from relnav_graph.cli.main import main

if __name__ == "__main__":
    main()
