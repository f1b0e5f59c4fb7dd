"""The studies of Kailas, Jain and Ravichandar (ICML 2025) on registered policies: do their claims hold?

`xmarl-bench study main|training|zero-shot` scores missing entries, judges every comparative statement of the
paper on the entries, and writes results.json, tables, figures and one page. docs/reproduction.md is made
of it.
"""
