"""The command line: parse, call `relnav_graph.runs`, print."""
