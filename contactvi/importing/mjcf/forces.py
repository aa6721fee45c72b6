"""What acts in an MJCF besides contacts and actuators: springs, compensation of gravity, equalities, tendons.

What MuJoCo does softly (solref, solimp) is exact here. Equalities become constraints, springs along sites tape springs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from contactvi.elements.constraints import Constraint, EqualityConstraint, PointConstraint, WeldConstraint
from contactvi.elements.element import WORLD, Element
from contactvi.elements.forces import PathSpring, Wrench
from contactvi.importing.mjcf.compiler import Source, pose, rotation
from contactvi.importing.mjcf.tree import Tree


class Forces:
    """Makes the elements of a file with the names of the scene.

    Args:
        prefix: of the names of the part.
        placement: of the part's world in the scene's.
        gravity: of the scene [m/s^2], shape (3,), which compensated bodies do not feel.
    """

    def __init__(self, source: Source, tree: Tree, prefix: str, placement: pin.SE3, gravity: np.ndarray) -> None:
        self.source, self.m, self.tree = source, source.m, tree
        self.prefix, self.placement, self.gravity = prefix, placement, gravity

    def springs(self) -> dict[str, tuple[float, Any]]:
        """Return stiffness [N m/rad or N/m] and rest of each joint with a spring, by the file's names.

        rest is a value of the joint, of a ball joint a quaternion (x, y, z, w).
        """
        m, found = self.m, dict[str, tuple[float, Any]]()
        if self.source.off("SPRING"):
            return found
        for j, name in enumerate(self.source.names["joint"]):
            if np.any(m.jnt_stiffnesspoly[j]):
                self.source.lose("joint", name, "stiffness that is no constant (stiffnesspoly)")
            if m.jnt_plasticadr[j] >= 0:
                self.source.lose("joint", name, "plastic spring")
            stiffness, kind = float(m.jnt_stiffness[j]), self.source.word("Joint", m.jnt_type[j])
            if stiffness == 0.0:
                continue
            first = int(m.jnt_qposadr[j])
            if kind == "free":
                self.source.lose("joint", name, "stiffness of a free joint")
            elif kind == "ball":
                w, x, y, z = np.array(m.qpos_spring[first : first + 4])
                found[name] = stiffness, np.array([x, y, z, w])
            else:
                found[name] = stiffness, float(m.qpos_spring[first])
        return found

    def wrenches(self) -> list[Element]:
        """Return the forces that compensate the gravity of bodies (gravcomp)."""
        m, found = self.m, list[Element]()
        for body in range(1, m.nbody):
            if m.body_gravcomp[body] and self.tree.joint[body]:
                force = -float(m.body_gravcomp[body] * m.body_mass[body]) * self.gravity
                name = f"{self._name('body', body)}_gravcomp"
                found.append(Wrench(name, self._name("body", body), force, None, np.array(m.body_ipos[body])))
        return found

    def constraints(self) -> list[Element]:
        """Return the equalities that are active at the start."""
        m, found = self.m, list[Element]()
        if self.source.off("EQUALITY") or self.source.off("CONSTRAINT"):
            return found
        for e, name in enumerate(self.source.names["equality"]):
            kind = self.source.word("Eq", m.eq_type[e])
            made: Constraint | None = None
            if not m.eq_active0[e]:
                self.source.lose("equality", name, "not active at the start")
                continue
            if kind in ("connect", "weld"):
                made = self._joined(e, kind)
            elif kind == "joint":
                made = self._equal(e)
            elif kind == "tendon":
                made = self._equal_by_tendon(e)
            if made is None:
                self.source.lose("equality", name, f"equality of type {kind}")
            else:
                found.append(made)
        return found

    def _joined(self, e: int, kind: str) -> Constraint:
        """Return a point or a weld. Data: point in a, point in b, then of a weld the rotation of b in a."""
        m, data, name = self.m, np.array(self.m.eq_data[e]), self._name("equality", e)
        one, two = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        if int(m.eq_objtype[e]) == self.source.number("Obj", "SITE"):
            bodies = int(m.site_bodyid[one]), int(m.site_bodyid[two])
            first, second = (pose(m.site_pos[s], m.site_quat[s]) for s in (one, two))
            points = first.translation, second.translation
            placement = first * second.inverse()
        else:
            bodies, points = (one, two), (data[:3], data[3:6])
            turn = rotation(data[6:10]) if kind == "weld" else np.eye(3)
            placement = pin.SE3(turn, data[3:6] - turn @ data[:3])
        a, b = (self._body(body) for body in bodies)
        if kind == "connect":
            at_a, at_b = (self._point(body, point) for body, point in zip(bodies, points, strict=True))
            return PointConstraint(name, a, b, at_a, at_b)
        if data[10] != 1.0:
            self.source.lose("equality", self.source.names["equality"][e], "torquescale of a weld")
        placement = self._in_world(bodies[0]) * placement * self._in_world(bodies[1]).inverse()
        return WeldConstraint(name, a, b, placement)

    def _equal(self, e: int) -> Constraint | None:
        """Return y - y0 = sum a_k (x - x0)^k in powers of x; x0 and y0 are the values of qpos0."""
        m, data = self.m, np.array(self.m.eq_data[e])
        one, two = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
        if any(j >= 0 and self.source.word("Joint", m.jnt_type[j]) in ("free", "ball") for j in (one, two)):
            return None
        y0, name = float(m.qpos0[m.jnt_qposadr[one]]), self._name("equality", e)
        if two < 0:
            return EqualityConstraint(name, self._name("joint", one), None, (y0 + float(data[0]),))
        x0 = float(m.qpos0[m.jnt_qposadr[two]])
        powers = np.polynomial.Polynomial(data[:5])(np.polynomial.Polynomial([-x0, 1.0])).coef
        coefficients = np.array([y0 + powers[0], *powers[1:]])
        return EqualityConstraint(name, self._name("joint", one), self._name("joint", two), coefficients)

    def _equal_by_tendon(self, e: int) -> Constraint | None:
        """Return sum c_k (q_k - q_k0) = a0 of a fixed tendon over one or two joints."""
        m, a0 = self.m, float(self.m.eq_data[e][0])
        row = self._fixed(int(m.eq_obj1id[e]))
        if int(m.eq_obj2id[e]) >= 0 or not 1 <= len(row) <= 2 or row[0][1] == 0.0:
            return None
        (one, c, q0), other = row[0], row[1:]
        name = self._name("equality", e)
        if not other:
            return EqualityConstraint(name, self._name("joint", one), None, (q0 + a0 / c,))
        two, d, p0 = other[0]
        return EqualityConstraint(
            name, self._name("joint", one), self._name("joint", two), (q0 + (a0 + d * p0) / c, -d / c)
        )

    def _fixed(self, tendon: int) -> list[tuple[int, float, float]]:
        """Return (joint, coefficient, qpos0) of a fixed tendon, empty for a spatial one."""
        m, found = self.m, []
        for w in self._wraps(tendon):
            if self.source.word("Wrap", m.wrap_type[w]) != "joint":
                return []
            j = int(m.wrap_objid[w])
            found.append((j, float(m.wrap_prm[w]), float(m.qpos0[m.jnt_qposadr[j]])))
        return found

    def tendons(self) -> list[Element]:
        """Return the springs and dampers along sites."""
        found: list[Element] = []
        for t, name in enumerate(self.source.names["tendon"]):
            kinds = {self.source.word("Wrap", self.m.wrap_type[w]) for w in self._wraps(t)}
            acts = self._acts(t)
            if kinds == {"joint"}:
                if acts:
                    self.source.lose("tendon", name, f"fixed tendon with {', '.join(acts)}")
            elif kinds == {"site"}:
                found += self._along_sites(t, acts)
            else:
                suffix = f" with {', '.join(acts)}" if acts else ""
                self.source.lose("tendon", name, f"tendon around shapes or over pulleys{suffix}")
        return found

    def _along_sites(self, t: int, acts: list[str]) -> list[Element]:
        m, name = self.m, self.source.names["tendon"][t]
        low, high = (float(x) for x in m.tendon_lengthspring[t])
        stiffness = 0.0 if self.source.off("SPRING") else float(m.tendon_stiffness[t])
        damping = 0.0 if self.source.off("DAMPER") else float(m.tendon_damping[t])
        rest = [text for text in acts if text not in ("stiffness", "damping")]
        if stiffness and low not in (0.0, high):
            rest.append("a spring with a dead band")
        if rest:
            self.source.lose("tendon", name, f"tendon with {', '.join(rest)}")
        if not (stiffness or damping):
            return []
        sites = [int(m.wrap_objid[w]) for w in self._wraps(t)]
        bodies = [int(m.site_bodyid[s]) for s in sites]
        if len(set(bodies)) < 2:
            self.source.lose("tendon", name, "tendon within one body")
            return []
        points = [(self._body(b), self._point(b, np.array(m.site_pos[s]))) for b, s in zip(bodies, sites, strict=True)]
        slack = low == 0.0 < high
        if slack and damping:
            self.source.lose("tendon", name, "damping of a slack tendon")
        return [PathSpring(self._name("tendon", t), points, stiffness, high, damping, slack)]

    def _acts(self, t: int) -> list[str]:
        m = self.m
        fields = ("stiffness", "damping", "limited", "frictionloss", "armature")
        return [name if name != "limited" else "limits" for name in fields if np.any(getattr(m, f"tendon_{name}")[t])]

    def _wraps(self, t: int) -> range:
        first = int(self.m.tendon_adr[t])
        return range(first, first + int(self.m.tendon_num[t]))

    def _name(self, kind: str, index: int) -> str:
        return self.prefix + self.source.names[kind][index]

    def _body(self, body: int) -> str:
        return self._name("body", body) if body else WORLD

    def _point(self, body: int, point: np.ndarray) -> np.ndarray:
        """Return a point in the frame of its body, in the scene's world if that is the file's."""
        return np.asarray(self._in_world(body).act(np.array(point, dtype=float)))

    def _in_world(self, body: int) -> pin.SE3:
        return pin.SE3.Identity() if body else self.placement
