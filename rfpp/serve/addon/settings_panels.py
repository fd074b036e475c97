"""Settings of scenes and of this machine, and their panels."""

from __future__ import annotations

import bpy

ENGINE = "RFPP"
_ADDRESS = "http://127.0.0.1:8700"


class RfppSettings(bpy.types.PropertyGroup):
    """Settings of a scene."""

    light_samples: bpy.props.IntProperty(
        name="Light Samples", default=16, min=1, max=4096,
        description="Shadow rays per light and pixel, and reflection rays: more give less noise",
    )  # fmt: skip
    supersampling: bpy.props.IntProperty(
        name="Supersampling", default=2, min=1, max=8,
        description="Shading points along each side of a pixel: more give smoother outlines",
    )  # fmt: skip
    viewport_pixels: bpy.props.IntProperty(
        name="Viewport Pixels", default=256, min=64, max=4096,
        description="Longer side of the viewport's picture",
    )  # fmt: skip


class RfppPreferences(bpy.types.AddonPreferences):
    """Settings of this machine: a file of somebody else must not choose where scenes are sent."""

    bl_idname = __package__

    address: bpy.props.StringProperty(
        name="Server", default=_ADDRESS, description="Address of `rfpp serve` on this machine"
    )

    def draw(self, context) -> None:
        self.layout.prop(self, "address")


class RfppPanel(bpy.types.Panel):
    """Panel in the render properties."""

    bl_idname = "RENDER_PT_rfpp"
    bl_label = "rfpp"
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 (Blender's name and type)

    @classmethod
    def poll(cls, context) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def draw(self, context) -> None:
        layout, settings = self.layout, context.scene.rfpp
        layout.use_property_split = True
        if (preferences := _preferences()) is not None:
            layout.prop(preferences, "address")
        column = layout.column(align=True)
        column.prop(settings, "light_samples")
        column.prop(settings, "supersampling")
        layout.prop(settings, "viewport_pixels")


def address() -> str:
    """Return the address of the server."""
    preferences = _preferences()
    return _ADDRESS if preferences is None else preferences.address


def _preferences() -> RfppPreferences | None:
    added = bpy.context.preferences.addons.get(__package__)
    return None if added is None else added.preferences


_CLASSES = (RfppSettings, RfppPreferences, RfppPanel)
_EXCLUDED = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "RENDER_PT_freestyle"}
#: Panels of other engines in which materials are edited.
_INCLUDED = {"EEVEE_MATERIAL_PT_context_material", "EEVEE_MATERIAL_PT_surface"}


def _shared_panels() -> list[type]:
    return [
        panel
        for panel in bpy.types.Panel.__subclasses__()
        if (name := panel.__name__) in _INCLUDED
        or ("BLENDER_RENDER" in getattr(panel, "COMPAT_ENGINES", ()) and name not in _EXCLUDED)
    ]


def register() -> None:
    """Register the classes with Blender."""
    for cls in _CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.rfpp = bpy.props.PointerProperty(type=RfppSettings)
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    """Unregister the classes."""
    for panel in _shared_panels():
        panel.COMPAT_ENGINES.discard(ENGINE)
    del bpy.types.Scene.rfpp
    for cls in reversed(_CLASSES):
        bpy.utils.unregister_class(cls)
