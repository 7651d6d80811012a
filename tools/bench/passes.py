"""Renders a view with Cycles: colour, z-depth and instances."""

import os

import bpy
import numpy as np

# Part of the scenes: another threshold gives other noise.
NOISE_THRESHOLD = 0.03
BACKGROUND_M = 60.0


class Renderer:
    """Cycles on the CPU. `threads` 0: all. With `motion_blur` the shutter is open for half a frame, centred.

    Depth and instances are those of the middle of the exposure.
    """

    def __init__(self, stage, samples, threads, motion_blur, scratch):
        self.stage, self.samples, self.blur, self.scratch = stage, samples, motion_blur, scratch
        blender = self.blender = stage.blender
        blender.render.engine = "CYCLES"
        blender.frame_start, blender.frame_end = 1, stage.scene.clip.frames
        blender.render.use_persistent_data = True
        blender.view_settings.view_transform = "Standard"
        if threads:
            blender.render.threads_mode, blender.render.threads = "FIXED", threads
        cycles = blender.cycles
        cycles.device = "CPU"
        cycles.use_adaptive_sampling, cycles.adaptive_threshold = True, NOISE_THRESHOLD
        cycles.max_bounces, cycles.diffuse_bounces = 3, 2
        layer = blender.view_layers[0]
        layer.use_pass_z = layer.use_pass_object_index = True
        blender.render.motion_blur_shutter = 0.5
        blender.render.motion_blur_position = "CENTER"
        settings = blender.render.image_settings
        if hasattr(settings, "media_type"):
            settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
        blender.render.filepath = str(scratch)
        # Cycles goes to the ends of the exposure by frames, so the scene follows Blender's frame.
        self.view_of = None
        bpy.app.handlers.frame_change_pre.append(self._on_frame)

    def render(self, position, view_of):
        """Colour [h][w][3] (8 bits, sRGB), z-depth [h][w] (metres, 0: none), instance [h][w] at `position`, in frames."""
        self.view_of = view_of
        exact = self._layers(position, samples=1 if self.blur else self.samples, blur=False)
        colour = self._layers(position, self.samples, blur=True) if self.blur else exact
        depth = exact["Depth"][..., 0]
        instance = np.rint(exact["Object Index"][..., 0]).astype(np.uint8)
        return _srgb(colour["Combined"][..., :3]), np.where(depth < BACKGROUND_M, depth, 0), instance

    def _on_frame(self, blender, _depsgraph=None):
        if self.view_of:
            position = blender.frame_float - 1
            self.stage.show(position, self.view_of(position))

    def _layers(self, position, samples, blur):
        """The passes of one run of Cycles by name."""
        import OpenImageIO as oiio

        self.blender.cycles.samples, self.blender.cycles.use_denoising = samples, samples > 1
        self.blender.render.use_motion_blur = blur
        whole = int(position)
        self.blender.frame_set(1 + whole, subframe=position - whole)
        bpy.context.view_layer.update()
        bpy.ops.render.render(write_still=True)
        file = oiio.ImageInput.open(str(self.scratch))
        if file is None:
            raise SystemExit(f"cannot read {self.scratch}: {oiio.geterror()}; is the disk full?")
        layers = {}
        while file.seek_subimage(len(layers), 0):
            spec = file.spec()
            layers[spec.channelnames[0].split(".")[1]] = np.asarray(file.read_image("float")).reshape(spec.height, spec.width, -1)
        file.close()
        os.remove(self.scratch)
        return layers


def _srgb(linear):
    """Linear colours to 8 bits."""
    linear = linear.clip(0, 1)
    curve = 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    return (np.where(linear <= 0.0031308, 12.92 * linear, curve) * 255 + 0.5).astype(np.uint8)
