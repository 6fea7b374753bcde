"""Whole files of the known track, line by line, each with what it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from known_tracks import known_tracks

NUKE = [
    ("set cut_paste_input [stack 0]", "how Nuke writes nodes that were copied: keep the node that is selected"),
    ("version 12.0 v1", "the Nuke that could have written it; Tracker4's table has been the same since"),
    ("push $cut_paste_input", "so that the tracker is plugged into the selected node"),
    ("Tracker4 {", "the node's class; its knobs follow"),
    (" tracks { { 1 31 2 }", "the table of tracks: version, number of columns, number of tracks"),
    ("{ { 5 1 20 enable e 1 }", "columns, with kind, flags, width, label and name; a checkbox that may be animated"),
    (" { 3 1 75 name name 1 }", "text"),
    (" { 2 1 58 track_x track_x 1 }", "a curve: where the track is"),
    (" { 2 1 58 track_y track_y 1 }", ""),
    (" { 2 1 63 offset_x offset_x 1 }", "a curve: what is added to it"),
    (" { 2 1 63 offset_y offset_y 1 }", ""),
    (" { 4 1 27 T T 1 }", "checkboxes: whether the track takes part in translation, rotation and scale"),
    (" { 4 1 27 R R 1 }", ""),
    (" { 4 1 27 S S 1 }", ""),
    (" { 2 0 45 error error 1 }", "a curve: how unlike the pattern a frame was; then its limits"),
    (" { 1 1 0 error_min error_min 1 }", ""),
    (" { 1 1 0 error_max error_max 1 }", ""),
    (" { 1 1 0 pattern_x pattern_x 1 }", "the box of the pattern about the track: left, bottom, right, top"),
    (" { 1 1 0 pattern_y pattern_y 1 }", ""),
    (" { 1 1 0 pattern_r pattern_r 1 }", ""),
    (" { 1 1 0 pattern_t pattern_t 1 }", ""),
    (" { 1 1 0 search_x search_x 1 }", "how far beyond it the pattern is sought"),
    (" { 1 1 0 search_y search_y 1 }", ""),
    (" { 1 1 0 search_r search_r 1 }", ""),
    (" { 1 1 0 search_t search_t 1 }", ""),
    (" { 2 1 0 key_track key_track 1 }", "from here on what Nuke's own tracking notes of its keyframes"),
    (" { 2 1 0 key_search_x key_search_x 1 }", ""),
    (" { 2 1 0 key_search_y key_search_y 1 }", ""),
    (" { 2 1 0 key_search_r key_search_r 1 }", ""),
    (" { 2 1 0 key_search_t key_search_t 1 }", ""),
    (" { 2 1 0 key_track_x key_track_x 1 }", ""),
    (" { 2 1 0 key_track_y key_track_y 1 }", ""),
    (" { 2 1 0 key_track_r key_track_r 1 }", ""),
    (" { 2 1 0 key_track_t key_track_t 1 }", ""),
    (" { 2 1 0 key_centre_offset_x key_centre_offset_x 1 }", ""),
    (" { 2 1 0 key_centre_offset_y key_centre_offset_y 1 }", "the 31st column"),
    ("}", "end of the columns"),
    ("{", "the tracks"),
    (
        ' { {curve K x1 1 x3 0 x4 1 x6 0} "point_00" {curve x1 0.5000 x2 639.5000 x4 320.0000 x5 10.7500} '
        "{curve x1 359.5000 x2 0.5000 x4 180.0000 x5 339.0000} {curve K x1 0} {curve K x1 0} 1 0 0 {curve x1 0} 0 0 "
        "-32 -32 32 32 -22 -22 22 22 {} {} {} {} {} {} {} {} {} {} {} }",
        "on from frame 1, off in 3, on in 4, off behind 5, in steps (K); a key in each frame in sight",
    ),
    (
        ' { {curve K x1 0 x4 1 x6 0} "point_01" {curve x4 1.5000 x5 3.5000} '
        "{curve x4 357.5000 x5 355.0000} {curve K x4 0} {curve K x4 0} 1 0 0 {curve x4 0} 0 0 "
        "-32 -32 32 32 -22 -22 22 22 {} {} {} {} {} {} {} {} {} {} {} }",
        "off until it comes into sight in frame 4",
    ),
    ("}", "end of the tracks"),
    ("}", "end of the table"),
    (" reference_frame 1", "in which the tracker moves nothing"),
    (" name Tracker_decomotion", "of the node"),
    ("}", "end of the node"),
]

AFTER_EFFECTS = [
    ("Adobe After Effects 8.0 Keyframe Data", "by which After Effects knows its own clipboard"),
    ("", ""),
    ("\tUnits Per Second\t25", "the clip's frame rate: keys below are in frames of it"),
    ("\tSource Width\t640", "the clip's size"),
    ("\tSource Height\t360", ""),
    ("\tSource Pixel Aspect Ratio\t1", "of the clip, and of a composition of its pixels"),
    ("\tComp Pixel Aspect Ratio\t1", ""),
    ("", ""),
    ("Effects\tADBE Point Control #1\tADBE Point Control-0001", "the first Point Control on the layer, its point"),
    ("\tFrame\tX pixels\tY pixels\t", "columns; After Effects ends rows with a tab"),
    ("\t0\t0.5000\t0.5000\t", "the middle of the top left pixel"),
    ("\t1\t639.5000\t359.5000\t", "the middle of the bottom right pixel"),
    ("\t3\t320.0000\t180.0000\t", "the middle of the frame; frame 2, hidden, has no key"),
    ("\t4\t10.7500\t21.0000\t", ""),
    ("", "end of the property"),
    ("Effects\tADBE Point Control #2\tADBE Point Control-0001", "the second Point Control on the same layer"),
    ("\tFrame\tX pixels\tY pixels\t", ""),
    ("\t3\t1.5000\t2.5000\t", ""),
    ("\t4\t3.5000\t5.0000\t", ""),
    ("", ""),
    ("", ""),
    ("End of Keyframe Data", "the last line"),
]

EQUALIZER = [
    ("2", "number of points"),
    ("point_00", "name of the first"),
    ("0", "its colour, red"),
    ("4", "number of its keys"),
    ("1 0.500000 359.500000", "frame, x, y: the middle of the top left pixel, y being up"),
    ("2 639.500000 0.500000", "the middle of the bottom right pixel"),
    ("4 320.000000 180.000000", "the middle of the frame; frame 3, hidden, has no line"),
    ("5 10.750000 339.000000", ""),
    ("point_01", "the second point"),
    ("0", ""),
    ("2", ""),
    ("4 1.500000 357.500000", ""),
    ("5 3.500000 355.000000", ""),
]

SYNTHEYES = [
    (
        "point_00 0 -1.000000000 -1.000000000 15",
        "name, frame, u, v of the top left pixel; run, enabled, found, key",
    ),
    ("point_00 1 1.000000000 1.000000000 7", "the bottom right pixel; run, enabled, found"),
    ("point_00 3 0.000000000 0.000000000 15", "the middle of the frame; a key, as frame 2 is hidden and has no line"),
    ("point_00 4 -0.967918623 -0.885793872 7", "2 * 10.25 / 639 - 1 and 2 * 20.5 / 359 - 1"),
    ("point_01 3 -0.996870110 -0.988857939 15", ""),
    ("point_01 4 -0.990610329 -0.974930362 7", ""),
]

PFTRACK = [
    ('# "Name"', "what the lines of a point are"),
    ("# clipNumber", ""),
    ("# frameCount", ""),
    ("# frame, xpos, ypos, similarity", ""),
    ("", "before each point"),
    ('"point_00"', "its name"),
    ("1", "the first clip of the project"),
    ("4", "number of its keys"),
    ("1 0.000000 359.000000 1.000000", "frame, x, y: the top left pixel, y being up from the lowest one; surely right"),
    ("2 639.000000 0.000000 1.000000", "the bottom right pixel"),
    ("4 319.500000 179.500000 1.000000", "the middle of the frame; frame 3, hidden, has no line"),
    ("5 10.250000 338.500000 1.000000", ""),
    ("", ""),
    ('"point_01"', ""),
    ("1", ""),
    ("2", ""),
    ("4 1.000000 357.000000 1.000000", ""),
    ("5 3.000000 354.500000 1.000000", ""),
]


@pytest.mark.parametrize(
    ("to", "name", "golden"),
    [
        ("nuke", "a.nk", NUKE),
        ("after-effects", "a.txt", AFTER_EFFECTS),
        ("3dequalizer", "a.txt", EQUALIZER),
        ("syntheyes", "a.txt", SYNTHEYES),
        ("pftrack", "a.txt", PFTRACK),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_golden(tmp_path: Path, to: str, name: str, golden: list[tuple[str, str]]):
    known_tracks().save(tmp_path / name, to)
    assert (tmp_path / name).read_bytes().decode("ascii").split("\n") == [*(line for line, _ in golden), ""]
