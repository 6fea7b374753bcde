"""Errors that a user can mend: every package's exception family grows from `InputError`."""


class InputError(ValueError):
    """Bad input; its text is one sentence: what was wrong, where, and what to do.

    The command-line tools print that sentence and exit with code 2 (`decomotion.console.run`). It stays one line
    whatever it quotes: line breaks become spaces, and what cannot be printed becomes its escape sequence.
    """

    def __init__(self, text: str) -> None:
        line = " ".join(part.strip() for part in text.splitlines())
        super().__init__("".join(each if each.isprintable() else repr(each)[1:-1] for each in line))


class ClipError(InputError):
    """The clip cannot be read: no frames, one frame, mixed sizes, or a frame that does not decode."""


class ConfigError(InputError):
    """A configuration value is unknown, of the wrong type, or out of range."""


class OutputError(InputError):
    """An output path cannot be written, or something is there that would be lost."""


class CheckpointError(InputError):
    """A run or its checkpoint is missing, damaged, or belongs to another clip."""


class SupervisionError(InputError):
    """Flow, features or masks given by the user do not fit the clip."""


class CorrectionError(InputError):
    """Corrections cannot be read, are not of the clip, or contradict each other."""


class DownloadError(SupervisionError):
    """Weights of a network that supervises cannot be downloaded."""


class EngineError(InputError):
    """The engine that tasks were to run on is not installed, does not answer, or has no room for them."""


class BatchError(InputError):
    """A list of clips cannot be read, or the folder of what is made of them is of other settings."""


class TrainingError(RuntimeError):
    """The optimisation itself failed, for example a loss that is not a number."""
