"""Protocols of other papers, under their names, beside the measures of this project. See docs/method.md."""
