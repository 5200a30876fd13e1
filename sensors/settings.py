"""Strict settings: an unknown key or a value without a meaning is one sentence, not a guess."""

import difflib
import types
import typing
from collections.abc import Mapping
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from sensors.errors import ConfigurationError


class Settings(BaseModel):
    """Base of all settings: frozen, no unknown keys, no NaN, errors in one sentence.

    Raises:
        ConfigurationError: naming the key, what is wrong with it, and the nearest valid one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            title = type(self).title_of(values)
            text = explain(type(self), error)
            raise ConfigurationError(f"{title}: {text}" if title else text) from None

    @classmethod
    def title_of(cls, values: Mapping[str, Any]) -> str:
        """What messages call a table with these values; empty for no name."""
        return ""

    @classmethod
    def parse(cls, values: Mapping[str, Any], where: str = "") -> Self:
        """Make the settings from a table of a file.

        Args:
            values: the table, as TOML or JSON gives it.
            where: what to call the table's origin in messages, for example the file's name.

        Raises:
            ConfigurationError: one sentence that begins with `where`.
        """
        try:
            return cls(**dict(values))
        except ConfigurationError as error:
            if not where:
                raise
            raise ConfigurationError(f"{where}: {error}") from None


def explain(model: type[BaseModel], error: ValidationError) -> str:
    """One sentence on the first thing that is wrong.

    Args:
        model: what was to be made.
        error: pydantic's complaint.
    """
    problems = error.errors(include_url=False)
    # A misspelt key also makes the right one missing: the misspelling is what to say.
    problems.sort(key=lambda problem: problem["type"] != "extra_forbidden")
    first = problems[0]
    where = _place(first["loc"])
    kind, last = first["type"], str(first["loc"][-1]) if first["loc"] else ""
    if kind == "extra_forbidden":
        valid = _keys_at(model, first["loc"][:-1])
        near = difflib.get_close_matches(last, valid, n=1, cutoff=0.5)
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(valid))}"
        text = f"unknown setting {where}; {hint}"
    elif kind == "missing":
        text = f"the setting {where} is missing"
    elif kind in ("union_tag_not_found", "union_tag_invalid"):
        text = _explain_tag(first)
    elif kind == "value_error":
        reason = str(first["ctx"]["error"]) if "ctx" in first else first["msg"]
        text = f"{where}: {reason}" if where else reason
    else:
        message = first["msg"][:1].lower() + first["msg"][1:]
        text = f"{where} is {_short(first['input'])}: {message}"
    more = len(problems) - 1
    return f"{text} (and {more} more)" if more else text


def _explain_tag(problem: Any) -> str:
    context = problem["ctx"]
    where = _place(problem["loc"])
    key = context["discriminator"].strip("'")
    valid = context.get("expected_tags", "").replace("'", "")
    if problem["type"] == "union_tag_not_found":
        return f'{where} has no {key}; name one, for example {key} = "is900"'
    near = difflib.get_close_matches(context["tag"], valid.split(", "), n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{where} has {key} {context['tag']!r}; {hint}there are {valid}"


def _place(loc: tuple[int | str, ...]) -> str:
    text = ""
    for part in loc:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _keys_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Valid keys of the table at a place: field by field, through lists and unions."""
    models = [model]
    for part in loc:
        if isinstance(part, int):
            continue
        fields = [m.model_fields[part] for m in models if part in m.model_fields]
        if fields:
            models = [m for f in fields for m in _models_in(f.annotation)]
        else:
            models = [m for m in models if _is_tagged(m, part)] or models
    return [name for m in models for name in m.model_fields]


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    if isinstance(annotation, types.GenericAlias | types.UnionType) or typing.get_args(annotation):
        return [m for a in typing.get_args(annotation) for m in _models_in(a)]
    return []


def _is_tagged(model: type[BaseModel], tag: str) -> bool:
    return any(tag in typing.get_args(f.annotation) for f in model.model_fields.values())
