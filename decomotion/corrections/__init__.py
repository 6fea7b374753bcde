"""Corrections: what a user says of a finished fit's tracks, and the short fit that follows from it.

file.py         corrections.csv, read and checked against the clip
points.py       its lines as points, each with all that is known of it
following.py    what the finished model says
trusted.py      the points' tracks bent through what is known, and what is near them
lesson.py       the supervision of the short fit, a pool like any other: those tracks, and the model's own answers
seams.py        a run of several windows: which of them know what of a point
fit.py          a new run from an old one
"""
