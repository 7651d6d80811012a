"""A scene as Blender's objects, and its state at a position of the clip."""

import bpy
import cameras
import materials
import numpy as np
from mathutils import Matrix
from shapes import Mesh, ObjFile


class Stage:
    """Builds a scene once and moves its objects, its lamp and the camera to any position of the clip."""

    def __init__(self, scene, width, height):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene, self.blender = scene, bpy.context.scene
        self.blender.render.resolution_x, self.blender.render.resolution_y = width, height
        for fixed in scene.fixed:
            made = _object(fixed.shape, fixed.material)
            made.location, made.rotation_euler = fixed.position, fixed.angles
        self.parts = []
        for part in scene.subject.parts:
            made = _object(part.shape, part.material)
            made.pass_index = part.instance
            if part.vertices:
                # Cycles blurs the deformation of meshes with shape keys alone.
                made.shape_key_add(name="rest")
                made.shape_key_add(name="pose").value = 1.0
            self.parts.append(made)
        self._light()
        self.camera = self._camera()

    def show(self, position, view):
        """Moves everything to `position`, in frames, and the camera to `view`."""
        seconds = self.scene.clip.seconds(position)
        subject = self.scene.subject
        for made, part, matrix in zip(self.parts, subject.parts, subject.pose(seconds), strict=True):
            made.matrix_world = Matrix(matrix)
            if part.vertices:
                _shape(made).foreach_set("co", part.vertices(seconds).astype(np.float32).ravel())
                made.data.update()
        if subject.lamp:
            self.lamp.location = subject.lamp.position(seconds)
        self.camera.matrix_world = cameras.matrix(view)

    def surface(self, index):
        """World vertices [n][3] and triangles [m][3] of part `index`, as last shown."""
        made = self.parts[index]
        mesh = made.data
        mesh.calc_loop_triangles()
        vertices = np.empty(len(mesh.vertices) * 3, np.float32)
        (_shape(made) if mesh.shape_keys else mesh.vertices).foreach_get("co", vertices)
        triangles = np.empty(len(mesh.loop_triangles) * 3, np.int32)
        mesh.loop_triangles.foreach_get("vertices", triangles)
        world = np.array(made.matrix_world)
        return vertices.reshape(-1, 3) @ world[:3, :3].T + world[:3, 3], triangles.reshape(-1, 3)

    def _light(self):
        room, subject = self.scene.room, self.scene.subject
        world = bpy.data.worlds.new("sky")
        self.blender.world = world
        world.use_nodes = True
        background = world.node_tree.nodes["Background"]
        background.inputs[0].default_value = (*room.sky, 1)
        background.inputs[1].default_value = room.sky_w * (0.5 + 0.5 * subject.sun)
        bpy.ops.object.light_add(type="SUN", rotation=room.sun_angles)
        sun = bpy.context.object.data
        sun.energy, sun.angle = room.sun_w * subject.sun, 0.05
        if subject.lamp:
            bpy.ops.object.light_add(type="POINT")
            self.lamp = bpy.context.object
            self.lamp.data.energy, self.lamp.data.shadow_soft_size = subject.lamp.power_w, subject.lamp.radius_m
            self.lamp.visible_camera = False

    def _camera(self):
        lens = bpy.data.cameras.new("camera")
        lens.sensor_fit, lens.angle, lens.clip_start = "HORIZONTAL", self.scene.rig.lens_rad, 0.05
        made = bpy.data.objects.new("camera", lens)
        self.blender.collection.objects.link(made)
        self.blender.camera = made
        return made


def _object(shape, material):
    """Blender's object of a shape, with the material alone."""
    if isinstance(shape, Mesh):
        made = _mesh(shape)
    elif isinstance(shape, ObjFile):
        bpy.ops.wm.obj_import(filepath=shape.path, forward_axis="Y", up_axis="Z")
        (made,) = bpy.context.selected_objects
    else:
        getattr(bpy.ops.mesh, f"primitive_{shape.kind}_add")(**shape.arguments)
        made = bpy.context.object
        if shape.smooth:
            bpy.ops.object.shade_smooth()
    made.data.materials.clear()
    made.data.materials.append(materials.build(material))
    return made


def _shape(made):
    """The vertices of a deforming object."""
    return made.data.shape_keys.key_blocks["pose"].data


def _mesh(shape):
    mesh = bpy.data.meshes.new("mesh")
    mesh.from_pydata(shape.vertices.tolist(), [], [list(face) for face in shape.faces])
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    mesh.uv_layers.new().data.foreach_set("uv", shape.uv[corners].astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", [shape.smooth] * len(mesh.polygons))
    mesh.update()
    made = bpy.data.objects.new("mesh", mesh)
    bpy.context.scene.collection.objects.link(made)
    return made
