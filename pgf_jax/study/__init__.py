"""Studies with people: a folder that says what participants do, and what they have done.

A study compares conditions within participants. `design.py` reads the folder, `orders.py` decides
who has which conditions in which order on which scenes, `questionnaires.py` says what is asked, and
`progress.py` where each participant is.
"""
