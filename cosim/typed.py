"""What files of others hold, through typed models: a wrong type, a missing or unknown entry is one sentence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, Field, ValidationError

from fmu_export.errors import UserError, shown
from fmu_export.variables import did_you_mean

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)]

T = TypeVar("T", bound=BaseModel)

_UNION = ("bool", "int", "float", "str")


def checked(model: type[T], data: Any, source: object) -> T:
    """Return `data` as `model`; raise UserError that names the source, the entry, the rule and what was found."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise UserError(f"{source}: {_first_problem(model, error)}") from None
    except RecursionError:  # an object inside itself
        raise UserError(f"{source} is nested too deeply") from None


def _first_problem(model: type[BaseModel], error: ValidationError) -> str:
    problem = error.errors(include_url=False)[0]
    place = [part for part in problem["loc"] if part != "[key]"]
    if problem["type"] == "extra_forbidden":
        return f"there is no entry {_dotted(place)}{did_you_mean(str(place[-1]), _known(model, place[:-1]))}"
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
    elif problem["type"] in ("tuple_type", "list_type"):
        rule = "must be a list"
    else:
        rule = problem["msg"].replace("Input should be", "must be")
    return f"{_dotted(place)} {rule}, found {shown(problem['input'])}".lstrip()


def _choice_problem(place: list[Any], about: Mapping[str, str]) -> str:
    """Return what is wrong with the entry that says which kind of table this is; pydantic quotes its name and the kinds."""
    entry = _dotted([*place, about["discriminator"].strip("'")])
    if "tag" not in about:
        return f"{entry} is required"
    tag, kinds = about["tag"], [kind.strip("'") for kind in about["expected_tags"].split(", ")]
    return f"{entry} must be one of {', '.join(kinds)}, found {shown(tag)}{did_you_mean(tag, kinds)}"


def _dotted(place: list[Any]) -> str:
    return ".".join(str(part) if isinstance(part, int) or len(part) < 80 else f"{part[:80]}..." for part in place)


def _known(model: type[BaseModel], place: list[Any]) -> list[str]:
    section: Any = model
    for part in place:
        declared: Mapping[str, Any] = getattr(section, "model_fields", {})
        section = declared[part].annotation if part in declared else section
    return list(getattr(section, "model_fields", {}))
