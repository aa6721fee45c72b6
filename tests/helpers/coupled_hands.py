"""Hands and fingers with coupled joints, as URDF: links with masses that differ, joints that follow others."""

from __future__ import annotations

import re

import numpy as np

import contactvi as cvi


def link(name, mass, length, inertia=None, axis="z"):
    """Return a link: a rod of a mass [kg] and a length [m] along x."""
    if mass == 0.0:
        return f'<link name="{name}"/>'
    own = mass * length**2 / 12.0 if inertia is None else inertia
    return (
        f'<link name="{name}"><inertial><origin xyz="{length / 2} 0.001 0.002"/><mass value="{mass}"/>'
        f'<inertia ixx="{0.3 * own}" iyy="{own}" izz="{own}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name, parent, child, xyz, axis=(0, 0, 1), kind="revolute", limits=(-9.0, 9.0), mimic=None, rpy=(0, 0, 0)):
    """Return a joint; mimic: (leader, ratio, offset)."""
    text = "" if mimic is None else f'<mimic joint="{mimic[0]}" multiplier="{mimic[1]}" offset="{mimic[2]}"/>'
    place, turn, along = (" ".join(map(str, row)) for row in (xyz, rpy, axis))
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="{place}" rpy="{turn}"/><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="{along}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="10" velocity="20"/>{text}</joint>'
    )


def robot(parts):
    return '<robot name="hand">' + "".join(parts) + "</robot>"


def finger(links=3, ratios=(1.1, 0.7, 0.5), offsets=(0.1, -0.05, 0.2)):
    """Return a finger: one leader, every other joint follows the one before it (a chain of couplings)."""
    parts = ['<link name="base"/>']
    for k in range(links):
        length, mass = 0.05 - 0.008 * k, 0.03 / (1.0 + k)
        parts.append(link(f"l{k}", mass, length))
        mimic = None if k == 0 else (f"j{k - 1}", ratios[k - 1], offsets[k - 1])
        at = (0.0, 0.0, 0.0) if k == 0 else (0.05 - 0.008 * (k - 1), 0.0, 0.0)
        parts.append(joint(f"j{k}", "base" if k == 0 else f"l{k - 1}", f"l{k}", at, (0.0, 1.0, 0.1 * k), mimic=mimic))
    return robot(parts)


def gripper(ratio=-1.0, offset=0.0, base_mass=0.0):
    """Return two fingers side by side, of which one slides and follows the other one, which turns."""
    parts = ['<link name="base"/>', link("palm", 0.2, 0.06), link("a", 0.03, 0.05), link("b", 0.05, 0.04)]
    parts.append(joint("wrist", "base", "palm", (0, 0, 0), (0, 1, 0)))
    parts.append(joint("left", "palm", "a", (0.05, 0.02, 0), (0, 0.6, 0.8)))
    parts.append(joint("right", "palm", "b", (0.05, -0.02, 0), (0, 1, 0), "prismatic", mimic=("left", ratio, offset)))
    return robot(parts)


def hand(fingers=5, links=3, mount="fixed", massless=(), ratio=lambda f, k: 0.6 + 0.1 * f + 0.15 * k):
    """Return a hand of several fingers: in each the first joint leads the others, with ratios and offsets.

    mount: "fixed": the fingers stand on the world; "arm": on a palm at a wrist with two joints. massless: links.
    """
    parts = ['<link name="base"/>']
    root = "base"
    if mount == "arm":
        parts += [link("fore", 0.6, 0.2), link("palm", 0.3, 0.08)]
        parts += [
            joint("w0", "base", "fore", (0, 0, 0), (0, 1, 0)),
            joint("w1", "fore", "palm", (0.2, 0, 0), (0, 0, 1)),
        ]
        root = "palm"
    for f in range(fingers):
        for k in range(links):
            name = f"f{f}l{k}"
            parts.append(link(name, 0.0 if name in massless else 0.02 / (1.0 + k), 0.04 - 0.006 * k))
            mimic = None if k == 0 else (f"f{f}j0", round(ratio(f, k), 3), 0.05 * k)
            at = (0.08, 0.02 * (f - 2), 0.0) if k == 0 else (0.04 - 0.006 * (k - 1), 0.0, 0.0)
            axis = (0.1 * (f - 2), 1.0, 0.0) if k < 2 else (0.0, 1.0, 0.2)
            parts.append(joint(f"f{f}j{k}", root if k == 0 else f"f{f}l{k - 1}", name, at, axis, mimic=mimic))
    return robot(parts)


def limited(text, joint, lower, upper):
    """Return the robot with other limits of a joint."""
    return re.sub(rf'(<joint name="{joint}".*?<limit lower=")[^"]*(" upper=")[^"]*', rf"\g<1>{lower}\g<2>{upper}", text)


def with_ball(text, link, radius, x):
    """Return the robot with a ball of a radius [m] on a link, at x [m] along it."""
    shape = f'<collision><origin xyz="{x} 0 0"/><geometry><sphere radius="{radius}"/></geometry></collision>'
    return re.sub(rf'(<link name="{link}">.*?)</link>', rf"\g<1>{shape}</link>", text)


def scene_of(text, folder, rows=False, gravity=(0.0, 0.0, -9.81), **options):
    """Return a scene of a URDF text; rows: the couplings as constraint rows, by a square that changes no digit."""
    path = folder / f"robot_{abs(hash(text))}.urdf"
    path.write_text(text)
    scene = cvi.Scene(gravity=gravity)
    scene.add_urdf(path, mimic=not rows, **options)
    if rows:
        for name, (leader, ratio, offset) in mimics(text).items():
            scene.add_joint_equality(name, leader, [offset, ratio, 1e-300], name=f"mimic_{name}")
    return scene


def mimics(text):
    """Return {joint: (leader, ratio, offset)} of a URDF text."""
    found = {}
    for part in re.findall(r"<joint .*?</joint>", text):
        tag = re.search(r'<mimic joint="(.*?)" multiplier="(.*?)" offset="(.*?)"/>', part)
        if tag:
            found[re.search(r'name="(.*?)"', part)[1]] = (tag[1], float(tag[2]), float(tag[3]))
    return found


def start_of(oracle, speed=3.0):
    """Return a start y, u of an oracle and the same as q, v of all joints."""
    n = len(oracle.free)
    y, u = 0.3 * np.sin(1.0 + np.arange(n)), speed * np.cos(np.arange(n))
    return y, u, oracle.q(y), oracle.S @ u
