"""Where the demo went."""

raise SystemExit("the demo is an example of the repository: make demo (examples/demo.py)")
