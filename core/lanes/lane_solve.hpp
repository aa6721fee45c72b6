// (M + diagonal)^-1 of one group of lanes with the stored factor. Included inside an unnamed namespace after
// lane_factor.hpp. dv is the right side on entry, u between the passes, the solution on return; the bodies' velocities
// in the storage are overwritten.

template <class V>
struct Force {
  V3<V> n, f;
};

// S: V, or double where all lanes share the kinematics.
template <class V, class S>
LANE_INLINE Force<V> force_to_parent(const LaneJoint& j, const S* at, Force<V> a) {
  if (j.type == kLaneBall) {
    a = {times_matrix(at, a.n), times_matrix(at, a.f)};
  } else if (j.type == kLaneTranslate) {
    a.n = a.n + offset_cross<V>(at, a.f);
    if (j.has_rotation) a = {times_matrix(j.C, a.n), times_matrix(j.C, a.f)};
  } else {
    if (j.type != kLaneTurn) {
      a.n.x = a.n.x - at[2] * a.f.y;
      a.n.y = a.n.y + at[2] * a.f.x;
    }
    a = {out_of_body(j, at, a.n), out_of_body(j, at, a.f)};
  }
  a.n = a.n + cross(j.r, a.f);
  return a;
}

template <class V>
inline void solve_backward(const Group<V>& g) {
  const V zero = Lane<V>::all(0.0);
  double* dv = g.work->dv;
  for (int i = g.tree->joints - 1; i >= 0; --i) {
    const LaneJoint& j = g.tree->joint[i];
    const V* at = g.storage + j.at;
    const V* W = at + j.velocity + 9;
    Force<V> a = {{zero, zero, zero}, {zero, zero, zero}};
    if (j.slot >= 0) a = {get3(g.slots + 6 * j.slot), get3(g.slots + 6 * j.slot + 3)};
    if (has_three(j)) {
      const V3<V> u = g.at3(dv, j.dof) - (j.type == kLaneBall ? a.n : a.f);
      g.put3(dv, j.dof, u);
      a = {a.n + times_matrix(W, u), a.f + times_matrix(W + 9, u)};
    } else {
      const V u = g.at(dv, j.dof) - along(j, a.n, a.f);
      g.put(dv, j.dof, u);
      a = {a.n + times(u, get3(W)), a.f + times(u, get3(W + 3))};
    }
    if (j.parent < 0) continue;
    a = force_to_parent(j, at, a);
    V* sum = g.slots + 6 * j.parent_slot;
    if (!j.first) a = {a.n + get3(sum), a.f + get3(sum + 3)};
    put3(sum, a.n);
    put3(sum + 3, a.f);
  }
}

// w and v of inherit(), without gravity.
template <class V, class S>
LANE_INLINE void velocity_into_body(const LaneJoint& j, const S* at, V3<V>& w, V3<V>& v) {
  v = v - cross(j.r, w);
  if (j.type == kLaneBall) {
    w = times_transpose(at, w);
    v = times_transpose(at, v);
  } else if (j.type == kLaneTranslate) {
    if (j.has_rotation) {
      w = times_transpose(j.C, w);
      v = times_transpose(j.C, v);
    }
    v = v - offset_cross<V>(at, w);
  } else {
    w = into_body(j, at, w);
    v = into_body(j, at, v);
    if (j.type != kLaneTurn) {
      v.x = v.x + w.y * at[2];
      v.y = v.y - w.x * at[2];
    }
  }
}

template <class V>
inline void solve_forward(const Group<V>& g) {
  const V zero = Lane<V>::all(0.0);
  double* dv = g.work->dv;
  for (int i = 0; i < g.tree->joints; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    V* at = g.storage + j.at;
    const V* W = at + j.velocity + 9;
    V3<V> w = {zero, zero, zero}, v = w;
    if (j.parent >= 0) {
      const V* up = g.storage + g.tree->joint[j.parent].at + g.tree->joint[j.parent].velocity;
      w = get3(up);
      v = get3(up + 3);
      velocity_into_body(j, at, w, v);
    }
    if (has_three(j)) {
      const V* D = W + 18;
      const V full[9] = {D[0], D[1], D[2], D[1], D[3], D[4], D[2], D[4], D[5]};
      const V3<V> x = times_matrix(full, g.at3(dv, j.dof)) - (times_transpose(W, w) + times_transpose(W + 9, v));
      g.put3(dv, j.dof, x);
      if (j.type == kLaneBall) {
        w = w + x;
      } else {
        v = v + x;
      }
    } else {
      const V x = g.at(dv, j.dof) * W[6] - (dot(get3(W), w) + dot(get3(W + 3), v));
      g.put(dv, j.dof, x);
      if (j.type != kLaneSlide) w.z = w.z + x;
      if (j.type != kLaneTurn) v.z = v.z + (j.type == kLaneSlide ? x : j.pitch * x);
    }
    put3(at + j.velocity, w);
    put3(at + j.velocity + 3, v);
  }
}
