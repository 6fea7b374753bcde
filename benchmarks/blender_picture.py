"""A frame of the clip with the tracks that a script of `decomo-convert` built in Blender, rendered by Blender.

    python benchmarks/blender_picture.py goat.py 60 goat-blender.png      # a Python with bpy 4.5

Places, muted markers and the frame's file are what Blender says: markers of the movie clip that are not muted in that
frame of the clip (from 1) are discs, and those of the ten frames before it tails.
"""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path
from typing import Any

import bpy  # pyright: ignore[reportMissingImports]

TAIL, RADIUS, WIDTH = 10, 4.0, 1.2
"""Frames; pixels."""


def main(script: str, frame: int, out: str) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    runpy.run_path(script)
    (clip,) = bpy.data.movieclips
    width, height = clip.size
    show_frame(clip, frame, width, height)
    colour = emission("track", (1.0, 0.08, 0.2))
    for track in clip.tracking.tracks:
        places = {m.frame: (m.co[0] * width, m.co[1] * height, 1.0) for m in track.markers if not m.mute}
        if frame in places:
            disc(places[frame], colour)
            tail([places[n] for n in range(frame - TAIL, frame + 1) if n in places], colour)
    render(width, height, out)


def show_frame(clip: Any, frame: int, width: int, height: int) -> None:
    """A plane with the frame's file: of a sequence, the number in the name of the clip's first file counts up."""
    first = Path(bpy.path.abspath(clip.filepath))
    digits = re.findall(r"\d+", first.stem)[-1]
    name = first.stem.replace(digits, f"{int(digits) + frame - 1:0{len(digits)}}")
    mesh = bpy.data.meshes.new("plane")
    mesh.from_pydata([(0, 0, 0), (width, 0, 0), (width, height, 0), (0, height, 0)], [], [(0, 1, 2, 3)])
    corners = mesh.uv_layers.new().data
    for corner, uv in zip(corners, ((0, 0), (1, 0), (1, 1), (0, 1)), strict=True):
        corner.uv = uv
    material = emission("frame", (1, 1, 1))
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(first.with_name(name + first.suffix)))
    material.node_tree.links.new(texture.outputs["Color"], nodes["Emission"].inputs["Color"])
    mesh.materials.append(material)
    add(mesh)


def emission(name: str, colour: tuple[float, float, float]) -> Any:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    light, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    light.inputs["Color"].default_value = (*colour, 1)
    material.node_tree.links.new(light.outputs[0], output.inputs[0])
    return material


def disc(place: tuple[float, float, float], material: Any) -> None:
    bpy.ops.mesh.primitive_circle_add(vertices=16, radius=RADIUS, fill_type="NGON", location=place)
    bpy.context.object.data.materials.append(material)


def tail(places: list[tuple[float, float, float]], material: Any) -> None:
    curve = bpy.data.curves.new("tail", "CURVE")
    curve.dimensions, curve.bevel_depth = "3D", WIDTH
    line = curve.splines.new("POLY")
    line.points.add(len(places) - 1)
    for point, place in zip(line.points, places, strict=True):
        point.co = (*place, 1)
    curve.materials.append(material)
    add(curve)


def add(data: Any) -> None:
    bpy.context.collection.objects.link(bpy.data.objects.new(data.name, data))


def render(width: int, height: int, out: str) -> None:
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale, camera.clip_end = "ORTHO", max(width, height), 1000
    holder = bpy.data.objects.new("camera", camera)
    holder.location = (width / 2, height / 2, 100)
    scene = bpy.context.scene
    scene.collection.objects.link(holder)
    scene.camera = holder
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "JPEG" if out.endswith("jpg") else "PNG"
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.filepath = str(Path(out).absolute())
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
