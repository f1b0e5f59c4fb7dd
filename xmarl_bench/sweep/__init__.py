"""A sweep: what many requests need, cut into pieces, computed where it is missing and kept in files.

`work` cuts, `content_key` (with `source_code`) names, `store` keeps, `finished` reads and writes results,
`compute` has the missing ones computed by whatever `xmarl_bench.fan_out` reaches, and `run_record` remembers
what was asked for.
"""
