"""The commands that show a result as a picture or as a page, or beside other results.

`opened` opens results and reports those not fit for use; `beside` finds what belongs to one (diagnosis, lineage);
`inches` changes what is printed, never the file; `requirement` gives the exit code of a condition.
"""
