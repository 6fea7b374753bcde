"""TAP-Vid's two ways of choosing query points, and with them the frames that count.

strided     every fifth frame, each point visible there is a query; all frames but the query's count
first       each track is queried where it is first visible; the frames after the query's count
"""

from __future__ import annotations

from decomo_eval.errors import EvalError

STRIDED, FIRST = "strided", "first"
QUERY_MODES = (STRIDED, FIRST)


def check_query_mode(query_mode: str) -> None:
    """Raises `EvalError` where `query_mode` is neither of the two."""
    if query_mode not in QUERY_MODES:
        raise EvalError(f"the query mode must be one of {', '.join(QUERY_MODES)}, not {query_mode!r}")
