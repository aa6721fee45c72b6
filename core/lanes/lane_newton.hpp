// The Newton matrix of the stage equations with their coupling A replaced by a diagonal d, in articulated form, for
// steps that turn so far that M alone does not contract. Included inside an unnamed namespace after lane_solve.hpp.
//
// With q moving as e v, e = h d: K = M + e (B - B^T), B = d(M v)/dq, and on balls the turning of the chart.
// Linearised around body velocities with inherited parts V' and subtree momenta H, for a joint with axes S, w = V' x
// S, c = e S x* H:
//   motion  dV = X dV_parent + (S + e w) dv        row      (S - e w)^T dH - c^T X dV_parent = r
//   force upwards  X^T (dH + c dv)                 balls:   dH row also turned, (1 + e [omega]) S^T dH - e [P] dv
// which articulated elimination factors in O(n) with a nonsymmetric inertia.

template <class V>
struct Inertia6 {
  V I[9], H[9], G[9], M[9];  // n = I w + H v, f = G w + M v
};

template <class V>
struct Axis {  // a motion or a force: three angular, three linear numbers
  V3<V> a, l;
};

// Storage of a joint after its factor: momentum (6), D^-1 (9), then for each axis motion (6), row (6), Uc (6), Ur
// (6).

template <class V>
LANE_INLINE V* newton_storage(const Group<V>& g, const LaneJoint& j) {
  return g.storage + j.at + j.velocity + 9 + (has_three(j) ? kLaneFactor3 : kLaneFactor1);
}

template <class V>
LANE_INLINE Axis<V> product(const Inertia6<V>& A, Axis<V> m) {
  return {times_matrix(A.I, m.a) + times_matrix(A.H, m.l), times_matrix(A.G, m.a) + times_matrix(A.M, m.l)};
}
template <class V>
LANE_INLINE Axis<V> product_transpose(const Inertia6<V>& A, Axis<V> f) {
  return {times_transpose(A.I, f.a) + times_transpose(A.G, f.l), times_transpose(A.H, f.a) + times_transpose(A.M, f.l)};
}
template <class V>
LANE_INLINE V dot(Axis<V> f, Axis<V> m) {
  return dot(f.a, m.a) + dot(f.l, m.l);
}
template <class V>
LANE_INLINE Axis<V> operator+(Axis<V> a, Axis<V> b) {
  return {a.a + b.a, a.l + b.l};
}
template <class V>
LANE_INLINE Axis<V> operator-(Axis<V> a, Axis<V> b) {
  return {a.a - b.a, a.l - b.l};
}
template <class V>
LANE_INLINE Axis<V> times(V k, Axis<V> a) {
  return {times(k, a.a), times(k, a.l)};
}
template <class V>
LANE_INLINE Axis<V> get6(const V* at) {
  return {get3(at), get3(at + 3)};
}
template <class V>
LANE_INLINE void put6(V* at, Axis<V> x) {
  put3(at, x.a);
  put3(at + 3, x.l);
}

template <class V>
LANE_INLINE Axis<V> joint_axis(const LaneJoint& j, int d) {
  const V zero = Lane<V>::all(0.0), one = Lane<V>::all(1.0);
  const V3<V> none = {zero, zero, zero};
  if (has_three(j)) {
    const V3<V> unit = {d == 0 ? one : zero, d == 1 ? one : zero, d == 2 ? one : zero};
    return j.type == kLaneBall ? Axis<V>{unit, none} : Axis<V>{none, unit};
  }
  const V3<V> z = {zero, zero, one};
  if (j.type == kLaneTurn) return {z, none};
  if (j.type == kLaneSlide) return {none, z};
  return {z, {zero, zero, Lane<V>::all(j.pitch)}};
}

// R A R^T block by block, and a change of the origin by -r, as in lane_factor.hpp.
template <class V, class S>
LANE_INLINE void turn_blocks(S c, S s, int i, int k, Inertia6<V>& A) {
  turn_general(c, s, i, k, A.I);
  turn_general(c, s, i, k, A.H);
  turn_general(c, s, i, k, A.G);
  turn_general(c, s, i, k, A.M);
}
template <class V, class S>
LANE_INLINE void turn_blocks_by(const S* R, Inertia6<V>& A) {
  V turned[9];
  V* const blocks[4] = {A.I, A.H, A.G, A.M};
  for (int b = 0; b < 4; ++b) {
    turn_full(R, blocks[b], turned);
    for (int i = 0; i < 9; ++i) blocks[b][i] = turned[i];
  }
}
template <class V, class R3>
LANE_INLINE void shift_blocks(const R3& r, Inertia6<V>& A) {
  for (int i = 0; i < 9; i += 3) {
    const V3<V> h = offset_cross<V>(r, V3<V>{A.H[i], A.H[i + 1], A.H[i + 2]});
    const V3<V> m = offset_cross<V>(r, V3<V>{A.M[i], A.M[i + 1], A.M[i + 2]});
    A.I[i] = A.I[i] + h.x;
    A.I[i + 1] = A.I[i + 1] + h.y;
    A.I[i + 2] = A.I[i + 2] + h.z;
    A.G[i] = A.G[i] + m.x;
    A.G[i + 1] = A.G[i + 1] + m.y;
    A.G[i + 2] = A.G[i + 2] + m.z;
  }
  for (int k = 0; k < 3; ++k) {
    const V3<V> g = offset_cross<V>(r, V3<V>{A.G[k], A.G[3 + k], A.G[6 + k]});
    const V3<V> m = offset_cross<V>(r, V3<V>{A.M[k], A.M[3 + k], A.M[6 + k]});
    A.I[k] = A.I[k] + g.x;
    A.I[3 + k] = A.I[3 + k] + g.y;
    A.I[6 + k] = A.I[6 + k] + g.z;
    A.H[k] = A.H[k] + m.x;
    A.H[3 + k] = A.H[3 + k] + m.y;
    A.H[6 + k] = A.H[6 + k] + m.z;
  }
}

template <class V>
LANE_INLINE void carry_blocks(const LaneJoint& j, const V* at, Inertia6<V>& A) {
  if (j.type == kLaneBall) {
    turn_blocks_by(at, A);
  } else if (j.type == kLaneTranslate) {
    shift_blocks<V>(at, A);
    if (j.has_rotation) turn_blocks_by(j.C, A);
  } else {
    if (j.type != kLaneTurn) {
      const V zero = Lane<V>::all(0.0);
      const V up[3] = {zero, zero, at[2]};
      shift_blocks<V>(up, A);
    }
    turn_blocks(at[0], at[1], 0, 1, A);
    turn_blocks(j.cos_alpha, j.sin_alpha, 1, 2, A);
    if (j.has_gamma) turn_blocks(j.cos_gamma, j.sin_gamma, 0, 1, A);
  }
  shift_blocks<V>(j.r, A);
}

template <class V>
LANE_INLINE void invert_general(const V* D, V* inverse) {
  const V a = D[4] * D[8] - D[5] * D[7], b = D[5] * D[6] - D[3] * D[8], c = D[3] * D[7] - D[4] * D[6];
  const V scale = 1.0 / (D[0] * a + D[1] * b + D[2] * c);
  inverse[0] = a * scale;
  inverse[3] = b * scale;
  inverse[6] = c * scale;
  inverse[1] = (D[2] * D[7] - D[1] * D[8]) * scale;
  inverse[4] = (D[0] * D[8] - D[2] * D[6]) * scale;
  inverse[7] = (D[1] * D[6] - D[0] * D[7]) * scale;
  inverse[2] = (D[1] * D[5] - D[2] * D[4]) * scale;
  inverse[5] = (D[2] * D[3] - D[0] * D[5]) * scale;
  inverse[8] = (D[0] * D[4] - D[1] * D[3]) * scale;
}

// Motion axes, rows, and c of a joint's dofs for the diagonal e.
template <class V>
struct Columns {
  Axis<V> motion[3], row[3], c[3];
};

template <class V>
LANE_INLINE Columns<V> columns(const Group<V>& g, const LaneJoint& j, V e, V turn, const V* newton) {
  const V zero = Lane<V>::all(0.0);
  const V* at = g.storage + j.at + j.velocity;
  Axis<V> inherited = get6(at);
  const Axis<V> H = get6(newton);
  V3<V> own = {zero, zero, zero};
  const int dofs = has_three(j) ? 3 : 1;
  for (int d = 0; d < dofs; ++d) inherited = inherited - times(g.at(g.work->v, j.dof + d), joint_axis<V>(j, d));
  if (j.type == kLaneBall) own = g.at3(g.work->v, j.dof);
  const bool root = j.parent < 0;
  Columns<V> k;
  for (int d = 0; d < dofs; ++d) {
    const Axis<V> S = joint_axis<V>(j, d);
    k.motion[d] = k.row[d] = S;
    k.c[d] = {{zero, zero, zero}, {zero, zero, zero}};
    if (!root) {
      const Axis<V> w = {cross(inherited.a, S.a), cross(inherited.a, S.l) + cross(inherited.l, S.a)};
      k.motion[d] = S + times(e, w);
      k.row[d] = S - times(e, w);
      k.c[d] = times(e, Axis<V>{cross(S.a, H.a) + cross(S.l, H.l), cross(S.a, H.l)});
    }
    // Row d of [omega] S^T: x -> omega x x.
    if (j.type == kLaneBall) k.row[d] = k.row[d] + times(turn, Axis<V>{cross(S.a, own), {zero, zero, zero}});
  }
  return k;
}

template <class V>
LANE_INLINE void eliminate_newton(const Group<V>& g, const LaneJoint& j, V e, V turn, V* newton, Inertia6<V>& A) {
  const int dofs = has_three(j) ? 3 : 1;
  const Columns<V> k = columns(g, j, e, turn, newton);
  Axis<V> Uc[3], Ur[3];
  V D[9], inverse[9];
  for (int d = 0; d < dofs; ++d) {
    const Axis<V> moved = product(A, k.motion[d]);
    Uc[d] = moved + k.c[d];
    Ur[d] = product_transpose(A, k.row[d]) - k.c[d];
    for (int r = 0; r < dofs; ++r) D[3 * r + d] = dot(k.row[r], moved) - dot(k.c[r], k.motion[d] - joint_axis<V>(j, d));
    D[4 * d] = D[4 * d] + g.at(g.work->diagonal, j.dof + d);
  }
  if (j.type == kLaneBall) {
    const V3<V> P = times(e, g.at3(g.work->P, j.dof));
    D[1] = D[1] + P.z;
    D[2] = D[2] - P.y;
    D[3] = D[3] - P.z;
    D[5] = D[5] + P.x;
    D[6] = D[6] + P.y;
    D[7] = D[7] - P.x;
  }
  if (dofs == 3) {
    invert_general(D, inverse);
    for (int i = 0; i < 9; ++i) newton[6 + i] = inverse[i];
  } else {
    newton[6] = inverse[0] = 1.0 / D[0];
  }
  V* axis = newton + 15;
  for (int d = 0; d < dofs; ++d, axis += 24) {
    put6(axis, k.motion[d]);
    put6(axis + 6, k.row[d]);
    put6(axis + 12, Uc[d]);
    put6(axis + 18, Ur[d]);
  }
  if (j.parent < 0) return;
  for (int d = 0; d < dofs; ++d) {
    Axis<V> left = times(inverse[dofs == 3 ? d : 0], Uc[0]);
    for (int r = 1; r < dofs; ++r) left = left + times(inverse[3 * r + d], Uc[r]);
    const V n[3] = {left.a.x, left.a.y, left.a.z}, f[3] = {left.l.x, left.l.y, left.l.z};
    const V w[3] = {Ur[d].a.x, Ur[d].a.y, Ur[d].a.z}, v[3] = {Ur[d].l.x, Ur[d].l.y, Ur[d].l.z};
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        A.I[3 * r + c] = A.I[3 * r + c] - n[r] * w[c];
        A.H[3 * r + c] = A.H[3 * r + c] - n[r] * v[c];
        A.G[3 * r + c] = A.G[3 * r + c] - f[r] * w[c];
        A.M[3 * r + c] = A.M[3 * r + c] - f[r] * v[c];
      }
  }
}

template <class V>
inline void factor_newton(const Group<V>& g) {
  const V e = load<V>(g.work->he + g.first()), turn = load<V>(g.work->he_turn + g.first());
  for (int i = g.tree->joints - 1; i >= 0; --i) {
    const LaneJoint& j = g.tree->joint[i];
    const Inertia<V> own = own_inertia<V>(j);
    Inertia6<V> A;
    spread(own.I, A.I);
    spread(own.M, A.M);
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c < 3; ++c) {
        A.H[3 * r + c] = own.H[3 * r + c];
        A.G[3 * r + c] = own.H[3 * c + r];
      }
    V* blocks[4] = {A.I, A.H, A.G, A.M};
    if (j.slot >= 0)
      for (int b = 0; b < 4; ++b)
        for (int k = 0; k < 9; ++k) blocks[b][k] = blocks[b][k] + g.slots[36 * j.slot + 9 * b + k];
    eliminate_newton(g, j, e, turn, newton_storage(g, j), A);
    if (j.parent < 0) continue;
    carry_blocks(j, g.storage + j.at, A);
    V* sum = g.slots + 36 * j.parent_slot;
    for (int b = 0; b < 4; ++b)
      for (int k = 0; k < 9; ++k) sum[9 * b + k] = j.first ? blocks[b][k] : sum[9 * b + k] + blocks[b][k];
  }
}

// first, end: the joints that are solved for, which are whole trees.
template <class V>
inline void solve_newton_backward(const Group<V>& g, int first, int end) {
  const V zero = Lane<V>::all(0.0);
  double* dv = g.work->dv;
  for (int i = end - 1; i >= first; --i) {
    const LaneJoint& j = g.tree->joint[i];
    const V *newton = newton_storage(g, j), *axis = newton + 15, *inverse = newton + 6;
    const int dofs = has_three(j) ? 3 : 1;
    Axis<V> a = {{zero, zero, zero}, {zero, zero, zero}};
    if (j.slot >= 0) a = get6(g.slots + 6 * j.slot);
    V u[3], scaled[3];
    for (int d = 0; d < dofs; ++d) u[d] = g.at(dv, j.dof + d) - dot(get6(axis + 24 * d + 6), a);
    for (int d = 0; d < dofs; ++d) {
      scaled[d] = inverse[dofs == 3 ? 3 * d : 0] * u[0];
      for (int k = 1; k < dofs; ++k) scaled[d] = scaled[d] + inverse[3 * d + k] * u[k];
      g.put(dv, j.dof + d, scaled[d]);
    }
    if (j.parent < 0) continue;
    for (int d = 0; d < dofs; ++d) a = a + times(scaled[d], get6(axis + 24 * d + 12));
    const Force<V> up = force_to_parent(j, g.storage + j.at, Force<V>{a.a, a.l});
    V* sum = g.slots + 6 * j.parent_slot;
    a = {up.n, up.f};
    if (!j.first) a = a + get6(sum);
    put6(sum, a);
  }
}

template <class V>
inline void solve_newton_forward(const Group<V>& g, int first, int end) {
  const V zero = Lane<V>::all(0.0);
  double* dv = g.work->dv;
  for (int i = first; i < end; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    V* at = g.storage + j.at;
    const V *newton = newton_storage(g, j), *axis = newton + 15, *inverse = newton + 6;
    const int dofs = has_three(j) ? 3 : 1;
    Axis<V> m = {{zero, zero, zero}, {zero, zero, zero}};
    V pull[3] = {zero, zero, zero};
    if (j.parent >= 0) {
      const V* up = g.storage + g.tree->joint[j.parent].at + g.tree->joint[j.parent].velocity;
      m = get6(up);
      velocity_into_body(j, at, m.a, m.l);
      for (int d = 0; d < dofs; ++d) pull[d] = dot(get6(axis + 24 * d + 18), m);
    }
    for (int d = 0; d < dofs; ++d) {
      V x = g.at(dv, j.dof + d) - inverse[dofs == 3 ? 3 * d : 0] * pull[0];
      for (int k = 1; k < dofs; ++k) x = x - inverse[3 * d + k] * pull[k];
      g.put(dv, j.dof + d, x);
      m = m + times(x, get6(axis + 24 * d));
    }
    put6(at + j.velocity, m);
  }
}
