"""Errors a user can cause; the command line prints their one line and exits.

TwinError
+-- ScenarioError     a scenario file or an override is wrong
+-- ModelError        the MJCF model or its cam table does not fit
+-- RecordError       a run folder cannot be written or read
"""


class TwinError(Exception):
    """Base of all errors whose message is one line: what, where, what is allowed."""


class ScenarioError(TwinError, ValueError):
    """A scenario, study or override asks for something that does not exist or cannot be."""


class ModelError(TwinError, ValueError):
    """The mechanism model or its cam table cannot be used as given."""


class RecordError(TwinError, OSError):
    """A run folder or its files cannot be written or read."""
