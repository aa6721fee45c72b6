// M v and dT/dq - dV/dq of one group of lanes in a forward and a backward pass, which store the kinematics.
// Included inside an unnamed namespace after lane_math.hpp.
//
// (dT/dq)_j = -S_j^T ((X v_parent) x* H_j), (dV/dq)_j = -S_j^T [c_j x g ; M_j g], H_j, c_j, M_j: momentum, first
// moment and mass of j's subtree in frame j. Storage of a joint, in vectors: 1 dof: cos, sin, shift; balls: R;
// translations: q; then velocity (w, v) and gravity g of its body, then the factor (lane_factor.hpp).

// The lanes of one group, which are stages of one step.
template <class V>
struct Group {
  typedef V Lanes;
  const LaneTree* tree;
  const LaneWork* work;
  V* storage;
  V* slots;
  int offset;  // of its first lane among the stages

  int row() const { return kOneStage ? Lane<V>::count : work->S; }
  int first() const { return kOneStage ? 0 : offset; }
  V at(const double* array, int dof) const { return Memory<V>::get(*work, array + dof * row() + first()); }
  void put(double* array, int dof, V x) const { Memory<V>::put(*work, array + dof * row() + first(), x); }
  // A number of the step, which all of its stages share.
  typename Memory<V>::Number number(const double* array, int index) const {
    return Memory<V>::number(*work, array + index);
  }
  double length() const { return work->h; }
  V3<V> at3(const double* array, int dof) const { return {at(array, dof), at(array, dof + 1), at(array, dof + 2)}; }
  void put3(double* array, int dof, V3<V> x) const {
    put(array, dof, x.x);
    put(array, dof + 1, x.y);
    put(array, dof + 2, x.z);
  }
};

// The lanes of one group, each of which is the only stage of the step of another run: what stages share is different in
// each of them. Functions of a Group that need no such number take it as one.
template <class V>
struct RunGroup : Group<V> {
  V number(const double* array, int index) const { return this->at(array, index); }
  V length() const { return number(this->work->run_h, 0); }
};

template <class V>
LANE_INLINE V3<V> get3(const V* at) {
  return {at[0], at[1], at[2]};
}
template <class V>
LANE_INLINE void put3(V* at, V3<V> x) {
  at[0] = x.x;
  at[1] = x.y;
  at[2] = x.z;
}

// Coordinates of a vector in the frame turned by (c, s) about z or x, and from it back.
template <class V, class S>
LANE_INLINE V3<V> into_z(S c, S s, V3<V> a) {
  return {c * a.x + s * a.y, c * a.y - s * a.x, a.z};
}
template <class V, class S>
LANE_INLINE V3<V> out_of_z(S c, S s, V3<V> a) {
  return {c * a.x - s * a.y, c * a.y + s * a.x, a.z};
}
template <class V, class S>
LANE_INLINE V3<V> into_x(S c, S s, V3<V> a) {
  return {a.x, c * a.y + s * a.z, c * a.z - s * a.y};
}
template <class V, class S>
LANE_INLINE V3<V> out_of_x(S c, S s, V3<V> a) {
  return {a.x, c * a.y - s * a.z, c * a.z + s * a.y};
}
template <class V>
LANE_INLINE V3<V> into_alpha(const LaneJoint& j, V3<V> a) {
  if (j.alpha == kLaneNoAngle) return a;
  if (j.alpha == kLaneQuarterTurn) return {a.x, a.z, -a.y};
  return into_x(j.cos_alpha, j.sin_alpha, a);
}
template <class V>
LANE_INLINE V3<V> out_of_alpha(const LaneJoint& j, V3<V> a) {
  if (j.alpha == kLaneNoAngle) return a;
  if (j.alpha == kLaneQuarterTurn) return {a.x, -a.z, a.y};
  return out_of_x(j.cos_alpha, j.sin_alpha, a);
}
template <class V, class S>
LANE_INLINE V3<V> times_matrix(const S* R, V3<V> a) {  // R a, row-major
  return {R[0] * a.x + R[1] * a.y + R[2] * a.z, R[3] * a.x + R[4] * a.y + R[5] * a.z,
          R[6] * a.x + R[7] * a.y + R[8] * a.z};
}
template <class V, class S>
LANE_INLINE V3<V> times_transpose(const S* R, V3<V> a) {
  return {R[0] * a.x + R[3] * a.y + R[6] * a.z, R[1] * a.x + R[4] * a.y + R[7] * a.z,
          R[2] * a.x + R[5] * a.y + R[8] * a.z};
}

// R = B exp(X)
template <class V, class S>
LANE_INLINE void ball_rotation(const S* B, V3<V> X, V* R) {
  const Rotation<V> k = rotation(X);
  const V xx = k.a * X.x * X.x, yy = k.a * X.y * X.y, zz = k.a * X.z * X.z;
  const V xy = k.a * X.x * X.y, xz = k.a * X.x * X.z, yz = k.a * X.y * X.z;
  const V sx = k.sinc * X.x, sy = k.sinc * X.y, sz = k.sinc * X.z;
  const V E[9] = {1.0 - (yy + zz), xy - sz, xz + sy, xy + sz,        1.0 - (xx + zz),
                  yz - sx,         xz - sy, yz + sx, 1.0 - (xx + yy)};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) R[3 * i + j] = B[3 * i] * E[j] + B[3 * i + 1] * E[3 + j] + B[3 * i + 2] * E[6 + j];
}

// The joint's own displacement at X.
template <class G>
LANE_INLINE void place_joint(const G& g, const LaneJoint& j) {
  typedef typename G::Lanes V;
  const LaneWork& w = *g.work;
  V* at = g.storage + j.at;
  switch (j.type) {
    case kLaneTurn:
      sine_cosine(g.number(w.base, j.dof) + g.at(w.X, j.dof), at[1], at[0]);
      break;
    case kLaneScrew: {
      const V angle = g.number(w.base, j.dof) + g.at(w.X, j.dof);
      sine_cosine(angle, at[1], at[0]);
      at[2] = j.pitch * (angle - j.turn);  // the frame's constant turn displaces nothing
      break;
    }
    case kLaneSlide:
      at[0] = Lane<V>::all(j.cos_fixed);
      at[1] = Lane<V>::all(j.sin_fixed);
      at[2] = g.number(w.base, j.dof) + g.at(w.X, j.dof);
      break;
    case kLaneTranslate:
      for (int d = 0; d < 3; ++d) at[d] = g.number(w.base, j.dof + d) + g.at(w.X, j.dof + d);
      break;
    default: {
      decltype(g.number(w.ball_base, 0)) B[9];
      for (int k = 0; k < 9; ++k) B[k] = g.number(w.ball_base, 9 * j.ball + k);
      ball_rotation(B, g.at3(w.X, j.dof), at);
    }
  }
}

template <class G>
inline void place_all(const G& g) {
  for (int i = 0; i < g.tree->joints; ++i) place_joint(g, g.tree->joint[i]);
}

template <class V>
struct Motion {
  V3<V> w, v, g;  // angular and linear velocity, gravity
};

// From the frame before the joint into the body's, for 1-dof joints.
template <class V, class S>
LANE_INLINE V3<V> into_body(const LaneJoint& j, const S* at, V3<V> a) {
  if (j.has_gamma) a = into_z(j.cos_gamma, j.sin_gamma, a);
  a = into_alpha(j, a);
  return into_z(at[0], at[1], a);
}

template <class V>
LANE_INLINE Motion<V> inherit(const LaneJoint& j, const V* at, Motion<V> m) {
  m.v = m.v - cross(j.r, m.w);  // w x r
  if (j.type == kLaneBall) return {times_transpose(at, m.w), times_transpose(at, m.v), times_transpose(at, m.g)};
  if (j.type == kLaneTranslate) {
    if (j.has_rotation) m = {times_transpose(j.C, m.w), times_transpose(j.C, m.v), times_transpose(j.C, m.g)};
    m.v = m.v + cross(m.w, get3(at));
    return m;
  }
  m = {into_body(j, at, m.w), into_body(j, at, m.v), into_body(j, at, m.g)};
  if (j.type != kLaneTurn) {  // the shift is along z, which the turn does not change
    m.v.x = m.v.x + m.w.y * at[2];
    m.v.y = m.v.y - m.w.x * at[2];
  }
  return m;
}

template <class V>
LANE_INLINE Motion<V> start_at_world(const LaneJoint& j, const V* at) {
  const V zero = Lane<V>::all(0.0);
  const V3<V> none = {zero, zero, zero};
  const V3<V> gravity = {Lane<V>::all(j.gravity[0]), Lane<V>::all(j.gravity[1]), Lane<V>::all(j.gravity[2])};
  if (j.type == kLaneBall) return {none, none, times_transpose(at, gravity)};
  if (j.type == kLaneTranslate) return {none, none, gravity};
  return {none, none, into_z(at[0], at[1], gravity)};
}

template <class G>
inline void forward(const G& g) {
  typedef typename G::Lanes V;
  const LaneWork& w = *g.work;
  for (int i = 0; i < g.tree->joints; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    V* at = g.storage + j.at;
    place_joint(g, j);
    Motion<V> m;
    if (j.parent < 0) {
      m = start_at_world(j, at);
    } else {
      const V* up = g.storage + g.tree->joint[j.parent].at + g.tree->joint[j.parent].velocity;
      m = inherit(j, at, {get3(up), get3(up + 3), get3(up + 6)});
    }
    switch (j.type) {
      case kLaneTurn:
        m.w.z = m.w.z + g.at(w.v, j.dof);
        break;
      case kLaneSlide:
        m.v.z = m.v.z + g.at(w.v, j.dof);
        break;
      case kLaneScrew:
        m.w.z = m.w.z + g.at(w.v, j.dof);
        m.v.z = m.v.z + j.pitch * g.at(w.v, j.dof);
        break;
      case kLaneTranslate:
        m.v = m.v + g.at3(w.v, j.dof);
        break;
      default:
        m.w = m.w + g.at3(w.v, j.dof);
    }
    put3(at + j.velocity, m.w);
    put3(at + j.velocity + 3, m.v);
    put3(at + j.velocity + 6, m.g);
  }
}

// Momentum (moment n, force f) and first moment c of a subtree.
template <class V>
struct Load {
  V3<V> n, f, c;
};

template <class V, class S>
LANE_INLINE V3<V> out_of_body(const LaneJoint& j, const S* at, V3<V> a) {
  a = out_of_z(at[0], at[1], a);
  a = out_of_alpha(j, a);
  return j.has_gamma ? out_of_z(j.cos_gamma, j.sin_gamma, a) : a;
}

template <class V>
LANE_INLINE Load<V> to_parent(const LaneJoint& j, const V* at, Load<V> l) {
  if (j.type == kLaneBall) {
    l = {times_matrix(at, l.n), times_matrix(at, l.f), times_matrix(at, l.c)};
  } else if (j.type == kLaneTranslate) {
    const V3<V> q = get3(at);
    l.n = l.n + cross(q, l.f);
    l.c = l.c + times(j.subtree_mass, q);
    if (j.has_rotation) l = {times_matrix(j.C, l.n), times_matrix(j.C, l.f), times_matrix(j.C, l.c)};
  } else {
    if (j.type != kLaneTurn) {
      l.n.x = l.n.x - at[2] * l.f.y;
      l.n.y = l.n.y + at[2] * l.f.x;
      l.c.z = l.c.z + j.subtree_mass * at[2];
    }
    l = {out_of_body(j, at, l.n), out_of_body(j, at, l.f), out_of_body(j, at, l.c)};
  }
  l.n = l.n + cross(j.r, l.f);
  l.c.x = l.c.x + j.subtree_mass * j.r[0];
  l.c.y = l.c.y + j.subtree_mass * j.r[1];
  l.c.z = l.c.z + j.subtree_mass * j.r[2];
  return l;
}

// Stores the force in one coordinate, from gravity, motion and linear forces, and if measure the sizes of its terms.
template <bool measure, class G, class V>
LANE_INLINE void put_force(const G& g, int dof, V gravity, V motion, V momentum) {
  const LaneWork& w = *g.work;
  V force = gravity - motion, size;
  if constexpr (measure) size = absolute(gravity) + absolute(motion);
  if (w.stiffness) {
    const V spring = g.number(w.stiffness, dof) * (g.number(w.deflection, dof) + g.at(w.X, dof));
    const V drag = g.number(w.damping, dof) * g.at(w.v, dof);
    force = force - spring - drag;
    if constexpr (measure) size = size + absolute(spring) + absolute(drag);
  }
  if (w.tau) {
    const auto tau = g.number(w.tau, dof);
    force = force + tau;
    if constexpr (measure) size = size + absolute(tau);
  }
  g.put(w.P, dof, momentum);
  g.put(w.G, dof, force);
  if constexpr (measure) g.put(w.magnitude, dof, size);
}

template <bool measure, class G, class V>
LANE_INLINE void put_joint_force(const G& g, const LaneJoint& j, const Motion<V>& m, const Load<V>& l) {
  const LaneWork& w = *g.work;
  const V zero = Lane<V>::all(0.0);
  const bool root = j.parent < 0;
  if (j.type == kLaneTranslate) {
    // The inherited angular velocity is w itself; of w x* f only the linear part acts along the joint.
    const V3<V> turn = root ? V3<V>{zero, zero, zero} : cross(m.w, l.f);
    const V3<V> v = g.at3(w.v, j.dof);
    put_force<measure>(g, j.dof, j.subtree_mass * m.g.x, turn.x, l.f.x + j.armature[0] * v.x);
    put_force<measure>(g, j.dof + 1, j.subtree_mass * m.g.y, turn.y, l.f.y + j.armature[1] * v.y);
    put_force<measure>(g, j.dof + 2, j.subtree_mass * m.g.z, turn.z, l.f.z + j.armature[2] * v.z);
    return;
  }
  const V3<V> fall = cross(l.c, m.g);
  if (j.type == kLaneBall) {
    const V3<V> v = g.at3(w.v, j.dof);
    const V3<V> turn = root ? V3<V>{zero, zero, zero} : cross(m.w - v, l.n) + cross(m.v, l.f);
    put_force<measure>(g, j.dof, fall.x, turn.x, l.n.x + j.armature[0] * v.x);
    put_force<measure>(g, j.dof + 1, fall.y, turn.y, l.n.y + j.armature[1] * v.y);
    put_force<measure>(g, j.dof + 2, fall.z, turn.z, l.n.z + j.armature[2] * v.z);
    return;
  }
  V momentum = zero, gravity = zero, motion = zero;
  if (j.type != kLaneSlide) {
    momentum = l.n.z;
    gravity = fall.z;
    if (!root) motion = (m.w.x * l.n.y - m.w.y * l.n.x) + (m.v.x * l.f.y - m.v.y * l.f.x);
  }
  if (j.type != kLaneTurn) {
    const double scale = j.type == kLaneSlide ? 1.0 : j.pitch;
    momentum = momentum + scale * l.f.z;
    gravity = gravity + (scale * j.subtree_mass) * m.g.z;
    if (!root) motion = motion + scale * (m.w.x * l.f.y - m.w.y * l.f.x);
  }
  put_force<measure>(g, j.dof, gravity, motion, momentum + j.armature[0] * g.at(w.v, j.dof));
}

// full: the sizes of the forces' terms are measured, and the subtree momenta are stored after the factors, for
// lane_newton.hpp.
template <bool full, class G>
inline void backward(const G& g) {
  typedef typename G::Lanes V;
  for (int i = g.tree->joints - 1; i >= 0; --i) {
    const LaneJoint& j = g.tree->joint[i];
    const V* at = g.storage + j.at;
    const Motion<V> m = {get3(at + j.velocity), get3(at + j.velocity + 3), get3(at + j.velocity + 6)};
    const double *I = j.inertia, *c = j.moment;
    Load<V> l;
    l.n = V3<V>{I[0] * m.w.x + I[1] * m.w.y + I[2] * m.w.z, I[1] * m.w.x + I[3] * m.w.y + I[4] * m.w.z,
                I[2] * m.w.x + I[4] * m.w.y + I[5] * m.w.z} +
          cross(c, m.v);
    l.f = times(j.mass, m.v) - cross(c, m.w);
    l.c = {Lane<V>::all(c[0]), Lane<V>::all(c[1]), Lane<V>::all(c[2])};
    if (j.slot >= 0) {
      const V* sum = g.slots + 9 * j.slot;
      l = {l.n + get3(sum), l.f + get3(sum + 3), l.c + get3(sum + 6)};
    }
    put_joint_force<full>(g, j, m, l);
    if (full) {
      V* momentum = g.storage + j.at + j.velocity + 9 +
                    (j.velocity == 9 || j.type == kLaneTranslate ? kLaneFactor3 : kLaneFactor1);
      put3(momentum, l.n);
      put3(momentum + 3, l.f);
    }
    if (j.parent < 0) continue;
    l = to_parent(j, at, l);
    V* sum = g.slots + 9 * j.parent_slot;
    if (!j.first) l = {l.n + get3(sum), l.f + get3(sum + 3), l.c + get3(sum + 6)};
    put3(sum, l.n);
    put3(sum + 3, l.f);
    put3(sum + 6, l.c);
  }
}
