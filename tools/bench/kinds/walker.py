"""A walking figure of capsules. Its feet stay where they are set down; knees follow by inverse kinematics."""

import math
from dataclasses import dataclass

import numpy as np
from materials import drawn_pattern
from paths import drawn_loop
from shapes import ball, box, capsule
from subject import Part, Subject
from transforms import placed, rotation, segment, translation

# Share of a stride in which a foot is on the ground.
STANCE = 0.6
UP = np.array([0.0, 0.0, 1.0])


@dataclass
class Figure:
    """Lengths in metres of a figure of `height`, in the proportions of an adult."""

    height: float

    def __post_init__(self):
        h = self.height
        self.thigh = self.shin = 0.245 * h
        self.ankle, self.foot, self.hip_half = 0.04 * h, 0.13 * h, 0.055 * h
        self.pelvis = self.ankle + 0.95 * (self.thigh + self.shin)
        self.torso, self.shoulder_half = 0.27 * h, 0.12 * h
        self.arm, self.forearm, self.head = 0.165 * h, 0.15 * h, 0.075 * h


@dataclass
class Gait:
    """Where the feet are at arc length `l` of the path: stride (two steps) and lift of the swinging foot in metres."""

    loop: object
    figure: Figure
    stride: float
    lift: float

    def foot(self, l, side):
        """Ankle [3], heading and pitch of the foot on `side` (1: left, -1: right)."""
        cycle = l / self.stride + 0.25 * side
        step = math.floor(cycle + 0.5)
        from_centre = cycle - step
        # On the ground around the centre of its stance, else in the air towards the next one.
        if abs(from_centre) <= STANCE / 2:
            share = 0.0
        else:
            if from_centre < 0:
                step -= 1
            share = (cycle - step - STANCE / 2) / (1 - STANCE)
        eased = share * share * (3 - 2 * share)
        placed_at = lambda n: self.loop.beside((n - 0.25 * side) * self.stride, side * self.figure.hip_half)
        x, y = (1 - eased) * placed_at(step) + eased * placed_at(step + 1)
        heading = self.loop.heading((step + eased - 0.25 * side) * self.stride)
        height = self.lift * math.sin(math.pi * share) ** 2
        pitch = 0.3 * math.sin(2 * math.pi * share) * math.sin(math.pi * share)
        return np.array([x, y, self.figure.ankle + height]), heading, pitch


def bent(start, end, first, second, forward):
    """The joint between two bones from `start` to `end`, bent towards `forward`."""
    line = end - start
    reach = min(np.linalg.norm(line), 0.9999 * (first + second))
    line /= np.linalg.norm(line)
    along = (reach * reach + first * first - second * second) / (2 * reach)
    out = forward - (forward @ line) * line
    return start + along * line + math.sqrt(max(first * first - along * along, 0.0)) * out / np.linalg.norm(out)


def make(rng):
    """One articulated object; height, gait, path and clothes are drawn."""
    figure = Figure(rng.uniform(1.05, 1.4))
    loop = drawn_loop(rng, (0.65, 0.9), (0.42, 0.5), eight=0.0)
    leg = figure.thigh + figure.shin
    gait = Gait(loop, figure, rng.uniform(1.05, 1.25) * leg, rng.uniform(0.08, 0.12) * leg)
    # A Froude number of a comfortable to brisk walk.
    speed = math.sqrt(rng.uniform(0.12, 0.25) * 9.81 * leg)
    lean, swing, bob = rng.uniform(0.02, 0.12), rng.uniform(0.35, 0.6), rng.uniform(0.01, 0.02) * leg
    shirt, trousers, skin, shoes = (drawn_pattern(rng, (8, 20)) for _ in range(4))
    limb = lambda radius, length, material: Part(1, capsule(radius * figure.height, length), material)
    parts = [limb(0.075, 0.5 * figure.torso, shirt), limb(0.07, 0.6 * figure.hip_half, trousers)]
    parts += [Part(1, ball(figure.head), skin), limb(0.03, 0.06 * figure.height, skin)]
    for _ in (1, -1):
        parts += [limb(0.045, figure.thigh, trousers), limb(0.036, figure.shin, trousers)]
        parts.append(Part(1, box(figure.foot, 0.055 * figure.height, 1.3 * figure.ankle), shoes))
        parts += [limb(0.028, figure.arm, shirt), limb(0.024, figure.forearm, skin)]

    def pose(seconds):
        l = speed * seconds
        cycle = 2 * math.pi * l / gait.stride
        (x, y), yaw = loop.at(l), loop.heading(l)
        # Highest over a standing foot, a quarter of a stride from the middle.
        pelvis_z = figure.pelvis - 0.02 * leg - bob * math.cos(2 * cycle)
        pelvis = placed(x, y, pelvis_z, yaw + 0.08 * math.cos(cycle)) @ translation(0, -0.015 * leg * math.sin(cycle), 0)
        chest = pelvis @ rotation("Z", -0.2 * math.cos(cycle)) @ rotation("Y", lean)
        at = lambda frame, *point: (frame @ (*point, 1))[:3]
        neck = at(chest, 0, 0, figure.torso)
        top = at(chest, 0.01 * figure.height, 0, figure.torso + 0.3 * figure.head)
        head = at(chest, 0.02 * figure.height, 0, figure.torso + 1.5 * figure.head)
        across = [at(pelvis, 0, side * 0.3 * figure.hip_half, 0.03) for side in (-1, 1)]
        body = [at(chest, 0, 0, 0.25 * figure.torso), at(chest, 0, 0, 0.75 * figure.torso)]
        turned = chest.copy()
        turned[:3, 3] = head
        matrices = [segment(*body, chest[:3, 0]), segment(*across, UP), turned, segment(neck, top + 0.01 * UP, chest[:3, 0])]
        for side in (1, -1):
            matrices += _leg(pelvis, gait, l, side) + _arm(chest, figure, swing, cycle, side)
        return matrices

    return Subject(("walker",), parts, pose, focus=(0.0, 0.0, 0.65))


def _leg(pelvis, gait, l, side):
    """Matrices of thigh, shin and foot."""
    figure = gait.figure
    hip = (pelvis @ (0, side * figure.hip_half, 0, 1))[:3]
    ankle, heading, pitch = gait.foot(l, side)
    forward = np.array([math.cos(heading), math.sin(heading), 0.0])
    knee = bent(hip, ankle, figure.thigh, figure.shin, forward)
    sole = -0.35 * figure.ankle
    foot = placed(*ankle, heading) @ rotation("Y", pitch) @ translation(0.25 * figure.foot, 0, sole)
    return [segment(hip, knee, forward), segment(knee, ankle, forward), foot]


def _arm(chest, figure, swing, cycle, side):
    """Matrices of upper arm and forearm, which swing against the leg of their side."""
    shoulder = chest @ translation(0, side * figure.shoulder_half, 0.92 * figure.torso)
    # The leg of this side is foremost where cos(cycle) is -side.
    angle = side * swing * math.cos(cycle)
    upper = shoulder @ rotation("X", side * 0.08) @ rotation("Y", -angle)
    elbow = upper @ translation(0, 0, -figure.arm)
    lower = elbow @ rotation("Y", -0.35 - 0.3 * max(angle, 0.0))
    joints = [m[:3, 3] for m in (upper, elbow, lower @ translation(0, 0, -figure.forearm))]
    return [segment(a, b, chest[:3, 0]) for a, b in zip(joints, joints[1:])]
