"""The first fault of a file's model, in the file's words: no name of a class, a type or a branch of a union."""

from dataclasses import dataclass
from typing import Annotated, Literal

import pytest
from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.base.model import Data, FilePath, Model, Number, validate


class Corner(Model):
    x: int = Field(ge=0)
    y: int = Field(ge=0)


@dataclass(frozen=True)
class Part(Data):
    size: Number


class Whole(Model):
    corner: Corner | Literal["middle"] | None = None
    files: dict[Literal["a", "b"], FilePath] = Field({})
    folder: FilePath | dict[str, Corner] | None = None
    several: Annotated[str | tuple[Corner, ...], Field()] = ""
    parts: dict[str, Part] = Field({})
    pair: tuple[int, int] = (0, 0)
    path: FilePath = "."


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"corner": "midle"}, "corner: must be a mapping of x, y, or 'middle' (got 'midle')"),
        ({"corner": {"x": 1, "y": -1}}, "corner.y: input should be greater than or equal to 0 (got -1)"),
        ({"corner": {"x": 1, "z": 1}}, "corner.y: required key is missing (and 1 more)"),
        ({"corner": {"x": 1, "y": 1, "z": 1}}, "corner.z: unknown key (got 'z'); allowed: x, y"),
        ({"files": {"c": "f"}}, "files.c: unknown key (got 'c'); allowed: 'a' or 'b'"),
        ({"files": "f"}, "files: must be a mapping (got 'f')"),
        ({"folder": 3}, "folder: must be a path, or a mapping (got 3)"),
        ({"folder": {"here": {"x": -1, "y": 1}}}, "folder.here.x: input should be greater than or equal to 0 (got -1)"),
        ({"several": [{"x": 1, "y": 1}, {"x": 1}]}, "several.1.y: required key is missing"),
        ({"several": 3}, "several: must be a valid string, or a list (got 3)"),
        ({"parts": {"k": {"size": 1.0, "sise": 2}}}, "parts.k.sise: unknown key (got 'sise'); allowed: size"),
        ({"parts": {"k": 3}}, "parts.k: must be a mapping (got 3)"),
        ({"pair": [1]}, "pair: too few numbers (got [1])"),
        ({"path": None}, "path: must be a path, and is empty"),
        ({"path": None, "corner": 0}, "corner: must be a mapping of x, y, or 'middle' (and 1 more) (got 0)"),
    ],
)
def test_the_first_fault_in_the_words_of_the_file(data, said):
    with pytest.raises(InputError) as refused:
        validate(Whole, data, "f.yaml")
    assert str(refused.value) == f"f.yaml: {said}"
