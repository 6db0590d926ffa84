"""A layout that draws nothing and refuses what Blender's own would refuse; what was drawn is kept as text."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import bpy

ICONS = bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys()


@dataclass
class FakeLayout:
    """Stands for bpy.types.UILayout, its rows and columns for themselves.

    Attributes:
        labels, properties, operators: What was drawn, in order; operators by their identifiers.
        set_on: Properties that were set on the operators drawn, by identifier.
        named: Words that were put in place of properties' own names.
    """

    labels: list[str] = field(default_factory=list)
    properties: list[str] = field(default_factory=list)
    operators: list[str] = field(default_factory=list)
    set_on: dict[str, SimpleNamespace] = field(default_factory=dict)
    named: dict[str, str] = field(default_factory=dict)

    def _part(self, **options: Any) -> FakeLayout:
        return self

    row = column = box = split = _part

    def label(self, *, text: str = "", icon: str = "NONE", translate: bool = True) -> None:
        self._check_icon(icon)
        self.labels.append(text)

    def prop(self, data: Any, name: str, *, index: int = -1, icon: str = "NONE", **options: Any) -> None:
        self._check_icon(icon)
        described = data.bl_rna.properties[name]
        assert index < max(getattr(described, "array_length", 0), 1)
        assert described.description, f"{name} has no tooltip"
        self.properties.append(name)
        if "text" in options:
            self.named[name] = options["text"]

    def prop_search(self, data: Any, name: str, where: Any, collection: str, **options: Any) -> None:
        assert collection in where.bl_rna.properties
        self.prop(data, name)

    def operator(self, identifier: str, *, text: str = "", icon: str = "NONE") -> SimpleNamespace:
        self._check_icon(icon)
        module, name = identifier.split(".")
        assert getattr(getattr(bpy.ops, module), name).get_rna_type().description, f"{identifier} has no tooltip"
        self.operators.append(identifier)
        self.set_on[identifier] = SimpleNamespace()
        return self.set_on[identifier]

    def template_list(self, list_type: str, *arguments: Any, **options: Any) -> None:
        assert hasattr(bpy.types, list_type)

    def progress(self, *, factor: float, text: str) -> None:
        assert 0.0 <= factor <= 1.0
        self.labels.append(text)

    def popover(self, *, panel: str, **options: Any) -> None:
        assert hasattr(bpy.types, panel)

    def separator(self) -> None: ...

    def _check_icon(self, icon: str) -> None:
        assert icon in ICONS, icon

    @property
    def text(self) -> str:
        return " ".join(self.labels)


def draw(panel: type[bpy.types.Panel]) -> FakeLayout:
    """A panel as it would be drawn now, with its header, in a sidebar 400 pixels wide."""
    layout = FakeLayout()
    context = SidebarContext()
    drawn = SimpleNamespace(layout=layout)
    for part in ("draw_header", "draw_header_preset", "draw"):
        if hasattr(panel, part):
            getattr(panel, part)(drawn, context)
    return layout


class SidebarContext:
    """Blender's context with the region that it lacks without a window."""

    region = SimpleNamespace(width=400)
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0), addons=bpy.context.preferences.addons)

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)
