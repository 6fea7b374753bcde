"""What was measured, as a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decomo_runtime.measure.files import write_csv
from decomo_runtime.measure.quantities import Measured, Quantity


def test_a_table_has_nine_digits_and_no_line_for_what_has_no_place(tmp_path: Path):
    keys = (Quantity("point", "1", np.array([[0, 0], [1, 1]])),)
    values = (
        Quantity("x", "px", np.array([[1.0, np.nan], [123456.789, 1 / 3]])),
        Quantity("occluded", "1", np.array([[False, False], [True, False]])),
        Quantity("strain", "1", np.array([[np.nan, 7], [1e-7, -2.5]])),
    )
    write_csv(Measured(keys, values, {}), tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().splitlines() == [
        "point [1],x [px],occluded [1],strain [1]",
        "0,1,0,",
        "1,123456.789,1,1e-07",
        "1,0.333333333,0,-2.5",
    ]
