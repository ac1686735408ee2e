"""The workbench: a local page on which a capture is looked at, fitted, judged and relit."""
