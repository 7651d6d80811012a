"""Materials as data, and as Blender's node trees. The photographs are those that scikit-image installs."""

import pathlib
from dataclasses import dataclass

PHOTOS = ("astronaut.png", "chelsea.png", "coffee.png", "rocket.jpg", "hubble_deep_field.jpg", "page.png")
SURFACES = ("gravel.png", "grass.png", "brick.png")
PATTERNS = ("noise", "voronoi", "checker")


@dataclass(frozen=True)
class Photo:
    """A photograph on the texture coordinates, repeated `repeat` times."""

    file: str
    repeat: float = 1.0
    roughness: float = 0.8


@dataclass(frozen=True)
class Pattern:
    """Two colours (linear RGB, 0..1) in a pattern of `scale` cells per unit of the object's or the texture's coordinates."""

    kind: str
    first: tuple
    second: tuple
    scale: float = 6.0
    roughness: float = 0.6
    metallic: float = 0.0
    coordinates: str = "Object"


def drawn_pattern(rng, scale, coordinates="Object", roughness=0.6, metallic=0.0):
    """A pattern whose colours differ by 0.25 to 0.6 in each channel; `scale` is a range."""
    first = rng.uniform(0.05, 0.9, 3)
    second = 0.05 + (first - 0.05 + rng.uniform(0.25, 0.6, 3)) % 0.85
    kind = PATTERNS[rng.integers(len(PATTERNS))]
    return Pattern(kind, tuple(first), tuple(second), rng.uniform(*scale), roughness, metallic, coordinates)


def drawn(rng, scale=(6, 16), coordinates="Object"):
    """A photograph or a pattern, one as likely as the other."""
    if rng.random() < 0.5:
        return Photo(PHOTOS[rng.integers(len(PHOTOS))])
    return drawn_pattern(rng, scale, coordinates)


def build(material):
    """Blender's material of `material`."""
    import bpy

    made = bpy.data.materials.new(type(material).__name__)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    surface = nodes["Principled BSDF"]
    surface.inputs["Roughness"].default_value = material.roughness
    coordinates = nodes.new("ShaderNodeTexCoord")
    if isinstance(material, Photo):
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(photo_path(material.file), check_existing=True)
        mapping = nodes.new("ShaderNodeMapping")
        mapping.inputs["Scale"].default_value = (material.repeat,) * 3
        links.new(coordinates.outputs["UV"], mapping.inputs["Vector"])
        links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
        links.new(texture.outputs["Color"], surface.inputs["Base Color"])
        return made
    surface.inputs["Metallic"].default_value = material.metallic
    node = {"noise": "ShaderNodeTexNoise", "voronoi": "ShaderNodeTexVoronoi", "checker": "ShaderNodeTexChecker"}
    texture = nodes.new(node[material.kind])
    texture.inputs["Scale"].default_value = material.scale
    ramp = nodes.new("ShaderNodeValToRGB")
    for element, colour, position in zip(ramp.color_ramp.elements, (material.first, material.second), (0.35, 0.65)):
        element.color = (*colour, 1)
        element.position = position
    links.new(coordinates.outputs[material.coordinates], texture.inputs["Vector"])
    links.new(texture.outputs["Color" if material.kind == "checker" else 0], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], surface.inputs["Base Color"])
    return made


def photo_path(file):
    """The path of one of scikit-image's photographs."""
    import skimage

    return str(pathlib.Path(skimage.__file__).parent / "data" / file)
