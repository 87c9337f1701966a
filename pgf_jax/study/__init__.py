"""Studies with people: a folder that says what participants do, and what they have done.

A study compares conditions within participants. `design.py` reads the folder, `orders.py` decides
who has which conditions in which order on which scenes, `questionnaires.py` says what is asked, and
`progress.py` where each participant is. `server.py`, `visit.py` and `block.py` serve the pages.

What has been done is read by `records.py`: `export.py` writes it as a data set, `analysis.py`
compares the conditions, `what_if.py` runs the blocks again under other policies. `sample_size.py`
estimates beforehand how many participants are needed.
"""
