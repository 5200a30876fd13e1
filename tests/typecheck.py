"""The checker of signatures in every test run: beartype, told what Python's typing means.

`Self` is only known to beartype where it decorates whole classes, and an int is a float
to every type checker but this one.
"""

from typing import Self

from beartype import BeartypeConf, FrozenDict, beartype

check = beartype(
    conf=BeartypeConf(
        is_pep484_tower=True,
        hint_overrides=FrozenDict({Self: object}),
    )
)
