"""Named errors. Each message says where, what was found, and what was expected."""

__all__ = [
    "EstimationError",
    "GeometryError",
    "InputError",
    "LateError",
    "ModelError",
    "RelnavError",
]


class RelnavError(Exception):
    """Base of all errors that this package raises on purpose."""


class InputError(RelnavError, ValueError):
    """A value, file or option given by the user is wrong."""


class LateError(InputError):
    """A measurement comes too late: its epoch has left the window, or was passed over."""


class ModelError(RelnavError, TypeError):
    """A model breaks its contract: a wrong shape, an unfilled Jacobian, an unknown kind."""


class GeometryError(RelnavError, ArithmeticError):
    """A measurement is impossible at this state, such as a point behind the camera.

    Raised by models; an estimator skips the observation and counts it.
    """


class EstimationError(RelnavError, RuntimeError):
    """An estimator cannot go on: an indeterminate or non-finite system."""
