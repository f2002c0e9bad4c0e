"""What files of others hold, through typed models: a wrong type, a missing or unknown entry is one sentence."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, ValidationError

from fmu_export.errors import UserError, shown
from fmu_export.variables import did_you_mean

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]

T = TypeVar("T", bound=BaseModel)

_UNION = ("bool", "int", "float", "str")
_RULES = {
    "float_type": "must be a number",
    "string_type": "must be a text",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "must be a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "must be true or false"),
    **dict.fromkeys(("tuple_type", "list_type"), "must be a list"),
}
"""Rules in the words of all messages, by pydantic's types of errors; its own words are plain for the others."""


def checked(model: type[T], data: Any, source: object) -> T:
    """Return `data` as `model`; raise UserError that names the source, the entry, the rule and what was found."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise UserError(f"{source}: {_first_problem(model, data, error)}") from None
    except RecursionError:  # an object inside itself
        raise UserError(f"{source} is nested too deeply") from None


def value_of(text: str, what: str) -> Any:
    """Return what a text of the command line says: read as TOML where it is, as plain text otherwise.

    Raises UserError that begins with `what` for what Python does not read.
    """
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text
    except (ValueError, RecursionError):  # a number of more digits, or lists of more levels, than Python takes
        raise UserError(f"{what} must be a number, a name or a short list, found {shown(text)}") from None


def _first_problem(model: type[BaseModel], data: Any, error: ValidationError) -> str:
    problem = error.errors(include_url=False)[0]
    place = _place(problem["loc"], data)
    if problem["type"] == "extra_forbidden":
        return f"there is no entry {_dotted(place)}{did_you_mean(str(place[-1]), _known(model, problem['loc'][:-1]))}"
    if problem["type"] == "missing":
        return f"{_dotted(place)} is required"
    if problem["type"] == "value_error":
        return f"{_dotted(place)} {problem.get('ctx', {}).get('error')}".lstrip()
    if problem["type"] in ("union_tag_not_found", "union_tag_invalid"):
        return _choice_problem(place, problem.get("ctx", {}))
    if place and place[-1] in _UNION:
        place, rule = place[:-1], "must be a number, true, false or a name"
    elif not place or problem["type"].startswith(("model", "dict")):
        rule = "must be a table"
    else:
        rule = _RULES.get(problem["type"]) or problem["msg"].replace("Input should be", "must be")
    return f"{_dotted(place)} {rule}, found {shown(problem['input'])}".lstrip()


def _place(location: Sequence[int | str], data: Any) -> list[int | str]:
    """Return the parts of an entry's name in a file's data; the kind of a table of a list stands behind its number."""
    place: list[int | str] = []
    for part in location:
        if part == "[key]":
            continue
        if place and isinstance(place[-1], int) and isinstance(data, Mapping) and data.get("kind") == part:
            place[-1] = f"{place[-1]} ({part})"
            continue
        place.append(part)
        data = _inside(data, part)
    return place


def _inside(data: Any, part: int | str) -> Any:
    """Return an entry of a table or a list, None where there is none."""
    try:
        return data[part]
    except (TypeError, LookupError):
        return None


def _choice_problem(place: list[Any], context: Mapping[str, str]) -> str:
    """Return what is wrong with the entry that says which kind of table this is; pydantic quotes its name and the kinds."""
    entry = _dotted([*place, context["discriminator"].strip("'")])
    if "tag" not in context:
        return f"{entry} is required"
    tag, kinds = context["tag"], [kind.strip("'") for kind in context["expected_tags"].split(", ")]
    return f"{entry} must be one of {', '.join(kinds)}, found {shown(tag)}{did_you_mean(tag, kinds)}"


def _dotted(place: list[Any]) -> str:
    return ".".join(str(part) if isinstance(part, int) or len(part) < 80 else f"{part[:80]}..." for part in place)


def _known(model: type[BaseModel], place: Sequence[Any]) -> list[str]:
    section: Any = model
    for part in place:
        declared: Mapping[str, Any] = getattr(section, "model_fields", {})
        section = declared[part].annotation if part in declared else section
    return list(getattr(section, "model_fields", {}))
