"""Everything that an artist presses or sets says what it is, in which unit, in words that Blender can translate."""

from __future__ import annotations

import ast
from pathlib import Path

import bpy
import pytest
import wrinkle_synthesis
from wrinkle_synthesis.operators import registration
from wrinkle_synthesis.wrinkle_addon.blender.panels.layout import UNITS

CLASSES = [cls for module in registration.MODULES for cls in module.classes]
OPERATORS = [cls for cls in CLASSES if issubclass(cls, bpy.types.Operator)]
GROUPS = [cls for cls in CLASSES if issubclass(cls, bpy.types.PropertyGroup | bpy.types.AddonPreferences)]
PANELS = [cls for cls in CLASSES if issubclass(cls, bpy.types.Panel | bpy.types.UIList)]

PURE = {"strength", "friction", "speed", "offset"}
"""Numbers without a unit, and times in frames."""

Property = bpy.types.Property


def described(cls: type) -> list[Property]:
    """The properties of an operator or a group that are shown, but for those that Blender itself brings."""
    kind = cls
    if issubclass(cls, bpy.types.Operator):
        group, name = cls.bl_idname.split(".")
        kind = getattr(getattr(bpy.ops, group), name).get_rna_type()
    properties = kind.bl_rna.properties if kind is cls else kind.properties
    own = {name for base in cls.__mro__ for name in vars(base).get("__annotations__", {})}
    return [each for each in properties if each.identifier in own and not each.is_hidden]


def test_operators_have_properties_to_look_at() -> None:
    # A guard for the tests below: the class of an operator does not list them, its Blender type does.
    assert {"goal", "error", "weights"} <= {each.identifier for cls in OPERATORS for each in described(cls)}


@pytest.mark.parametrize("cls", [*OPERATORS, *PANELS], ids=lambda cls: cls.__name__)
def test_what_is_pressed_or_opened_says_what_it_does(cls: type) -> None:
    assert cls.__doc__ and cls.__doc__.strip()
    # As Blender's own tooltips, which end without a full stop.
    assert not cls.__doc__.rstrip().endswith("."), cls.__doc__
    assert issubclass(cls, bpy.types.UIList) or cls.bl_label


@pytest.mark.parametrize("cls", [*OPERATORS, *GROUPS], ids=lambda cls: cls.__name__)
def test_what_is_set_says_what_it_is(cls: type) -> None:
    shown = [each for each in described(cls) if each.type not in ("POINTER", "COLLECTION")]
    bare = [each.identifier for each in shown if not each.description]
    bare += [
        f"{each.identifier}: {item.identifier}"
        for each in shown
        if each.type == "ENUM"
        for item in each.enum_items
        if not item.description
    ]
    assert not bare, ", ".join(bare)
    ended = [each.identifier for each in shown if each.description.endswith(".") and ". " not in each.description]
    assert not ended, ", ".join(ended)


@pytest.mark.parametrize("cls", [*OPERATORS, *GROUPS], ids=lambda cls: cls.__name__)
def test_numbers_say_their_unit(cls: type) -> None:
    numbers = [each for each in described(cls) if each.type == "FLOAT" and each.identifier not in PURE]
    without = [
        each.identifier
        for each in numbers
        if each.unit == "NONE"
        and each.subtype not in ("PERCENTAGE", "FACTOR")
        and not each.description.endswith(tuple(f", {unit}" for unit in UNITS))
    ]
    assert not without, ", ".join(without)


def test_words_in_the_sidebar_are_translated_before_they_are_filled_in() -> None:
    """Blender looks whole sentences up; one with a name or a number already in it is in no dictionary."""
    package = Path(wrinkle_synthesis.__file__).parent
    filled = []
    for path in [*(package / "wrinkle_addon" / "blender").rglob("*.py"), *(package / "operators").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            options = {each.arg: each.value for each in node.keywords}
            translates = not isinstance(kept := options.get("translate"), ast.Constant) or kept.value is not False
            text = options.get("text")
            if node.func.attr in ("label", "operator", "prop") and isinstance(text, ast.JoinedStr) and translates:
                filled.append(f"{path.name}:{node.lineno}")
    assert not filled, ", ".join(filled)
