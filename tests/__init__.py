"""The tests; jaxtyping's import hook finds the checker of signatures as `tests.typecheck`."""

from tests import typecheck as typecheck
