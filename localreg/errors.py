"""Errors of the package: one base class, messages that say what to do."""


class LocalregError(Exception):
    """Something the user can mend; the message is one sentence that says how."""


class SubjectError(LocalregError):
    """A subject file or skeleton that cannot be used."""


class MotionError(LocalregError):
    """A motion file that cannot be read or written; names the file and the line."""


class DatabaseError(LocalregError):
    """A pose database that is damaged, foreign, empty or from another version."""


class SynthesisError(LocalregError):
    """Settings or trackers that the synthesizer cannot work with."""
