"""What goes wrong on export."""

from decomotion.errors import InputError


class ExportError(InputError):
    """The model cannot be exported, or its file disagrees with torch."""
