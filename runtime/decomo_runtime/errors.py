"""What can be wrong with a model file, a query or an output; each text is one sentence that says what to do."""

from __future__ import annotations

from decomotion.errors import InputError


class RuntimeInputError(InputError):
    """Bad input to the runtime: the parent of all errors that this package raises on purpose (a `ValueError`)."""


class ModelFileError(RuntimeInputError):
    """The model file is missing, damaged, not ours, or of a newer format than this runtime reads."""


class SessionError(RuntimeInputError):
    """`providers=` or `threads=` ask for something that this machine's onnxruntime does not have."""


class QueryError(RuntimeInputError):
    """A query point, a target frame or a chunk size is malformed or out of range; the text names the row."""


class TracksFileError(RuntimeInputError):
    """A tracks file is not one."""


class OverlayError(RuntimeInputError):
    """The clip given, to be drawn on or changed, is not the one that the model was fitted to."""


class FlowError(RuntimeInputError):
    """Dense correspondence is asked for between frames, or in a format, that do not exist."""


class RefinementError(RuntimeInputError):
    """The frames or the tracks are not of the clip that the model was fitted to, so that nothing can be refined."""


class RenderError(RuntimeInputError):
    """What is to be rendered does not exist, no video can show it, or options of a rendering contradict each other."""


class ViewError(RuntimeInputError):
    """The page cannot be served at that port, or options contradict each other."""


class MeasureError(RuntimeInputError):
    """What is to be measured does not exist, or units, rates and sizes of a measurement contradict each other."""


class AnnotationError(RuntimeInputError):
    """What was drawn is of another clip or frame, is damaged, or does not say what is needed to carry it."""
