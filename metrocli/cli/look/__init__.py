"""The commands that show a result as a picture or as a page, or beside other results.

`opened` opens results, reports those not fit for use, and has `--require`, which gives the exit code. A command each:
`plot` (finds diagnosis, earlier result and lineage of a result), `report` (pages with these), `verify`, and `compare`,
with `repeated` for three results or more. `inches` changes what is printed, never the file.
"""
