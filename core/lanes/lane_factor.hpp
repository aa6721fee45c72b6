// M + diagonal in articulated form, factored in one backward pass and solved in one backward and one forward pass
// (Featherstone, Rigid Body Dynamics Algorithms, ch. 7, in momentum form: no bias terms). Included inside an unnamed
// namespace after lane_dynamics.hpp. After its kinematics a joint stores W = U D^-1 and D^-1 (1 dof: 6 + 1 vectors,
// 3 dofs: 18 + 6).

// Articulated inertia: n = I w + H v, f = H^T w + M v; I, M symmetric (xx xy xz yy yz zz), H row-major.
template <class V>
struct Inertia {
  V I[6], H[9], M[6];
};

template <class V, class S>
LANE_INLINE void turn_symmetric_z(S c, S s, V* A) {
  const V a = c * A[0] - s * A[1], b = c * A[1] - s * A[3], e = s * A[0] + c * A[1], f = s * A[1] + c * A[3];
  const V xz = A[2], yz = A[4];
  A[0] = c * a - s * b;
  A[1] = s * a + c * b;
  A[3] = s * e + c * f;
  A[2] = c * xz - s * yz;
  A[4] = s * xz + c * yz;
}
template <class V, class S>
LANE_INLINE void turn_symmetric_x(S c, S s, V* A) {
  const V a = c * A[3] - s * A[4], b = c * A[4] - s * A[5], e = s * A[3] + c * A[4], f = s * A[4] + c * A[5];
  const V xy = A[1], xz = A[2];
  A[3] = c * a - s * b;
  A[4] = s * a + c * b;
  A[5] = s * e + c * f;
  A[1] = c * xy - s * xz;
  A[2] = s * xy + c * xz;
}
// Turns rows, then columns, i and j of a general matrix.
template <class V, class S>
LANE_INLINE void turn_general(S c, S s, int i, int j, V* A) {
  for (int k = 0; k < 3; ++k) {
    const V a = A[3 * i + k], b = A[3 * j + k];
    A[3 * i + k] = c * a - s * b;
    A[3 * j + k] = s * a + c * b;
  }
  for (int k = 0; k < 3; ++k) {
    const V a = A[3 * k + i], b = A[3 * k + j];
    A[3 * k + i] = c * a - s * b;
    A[3 * k + j] = s * a + c * b;
  }
}
template <class V, class S>
LANE_INLINE void turn_z(S c, S s, Inertia<V>& A) {
  turn_symmetric_z(c, s, A.I);
  turn_symmetric_z(c, s, A.M);
  turn_general(c, s, 0, 1, A.H);
}
template <class V, class S>
LANE_INLINE void turn_x(S c, S s, Inertia<V>& A) {
  turn_symmetric_x(c, s, A.I);
  turn_symmetric_x(c, s, A.M);
  turn_general(c, s, 1, 2, A.H);
}

template <class V>
LANE_INLINE void quarter_symmetric(V* A) {
  const V xy = A[1], yy = A[3];
  A[1] = -A[2];
  A[2] = xy;
  A[3] = A[5];
  A[4] = -A[4];
  A[5] = yy;
}
template <class V>
LANE_INLINE void quarter_general(V* A) {
  const V xy = A[1], yx = A[3], yy = A[4], yz = A[5];
  A[1] = -A[2];
  A[2] = xy;
  A[3] = -A[6];
  A[4] = A[8];
  A[5] = -A[7];
  A[6] = yx;
  A[7] = -yz;
  A[8] = yy;
}
template <class V>
LANE_INLINE void turn_alpha(const LaneJoint& j, Inertia<V>& A) {
  if (j.alpha == kLaneNoAngle) return;
  if (j.alpha == kLaneQuarterTurn) {
    quarter_symmetric(A.I);
    quarter_symmetric(A.M);
    quarter_general(A.H);
  } else {
    turn_x(j.cos_alpha, j.sin_alpha, A);
  }
}

// R A R^T for full rotations.
template <class V, class S>
LANE_INLINE void turn_full(const S* R, const V* A, V* out) {
  V RA[9];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) RA[3 * i + k] = R[3 * i] * A[k] + R[3 * i + 1] * A[3 + k] + R[3 * i + 2] * A[6 + k];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k)
      out[3 * i + k] = RA[3 * i] * R[3 * k] + RA[3 * i + 1] * R[3 * k + 1] + RA[3 * i + 2] * R[3 * k + 2];
}
template <class V>
LANE_INLINE void spread(const V* A, V* full) {
  const V all[9] = {A[0], A[1], A[2], A[1], A[3], A[4], A[2], A[4], A[5]};
  for (int i = 0; i < 9; ++i) full[i] = all[i];
}
template <class V>
LANE_INLINE void gather(const V* full, V* A) {
  A[0] = full[0];
  A[1] = full[1];
  A[2] = full[2];
  A[3] = full[4];
  A[4] = full[5];
  A[5] = full[8];
}
template <class V, class S>
LANE_INLINE void turn_by(const S* R, Inertia<V>& A) {
  V full[9], turned[9];
  spread(A.I, full);
  turn_full(R, full, turned);
  gather(turned, A.I);
  spread(A.M, full);
  turn_full(R, full, turned);
  gather(turned, A.M);
  turn_full(R, A.H, turned);
  for (int i = 0; i < 9; ++i) A.H[i] = turned[i];
}

template <class V, class R3>
LANE_INLINE V3<V> offset_cross(const R3& r, V3<V> a) {
  return {r[1] * a.z - r[2] * a.y, r[2] * a.x - r[0] * a.z, r[0] * a.y - r[1] * a.x};
}
// Moves the origin by -r: H += [r] M, I += (r x h_j)_i + (r x h'_i)_j with the rows h of H before and h' after.
template <class V, class R3>
LANE_INLINE void shift_by(const R3& r, Inertia<V>& A) {
  const V3<V> before[3] = {{A.H[0], A.H[1], A.H[2]}, {A.H[3], A.H[4], A.H[5]}, {A.H[6], A.H[7], A.H[8]}};
  const V3<V> M[3] = {{A.M[0], A.M[1], A.M[2]}, {A.M[1], A.M[3], A.M[4]}, {A.M[2], A.M[4], A.M[5]}};
  for (int k = 0; k < 3; ++k) {
    const V3<V> add = offset_cross<V>(r, M[k]);
    A.H[k] = A.H[k] + add.x;
    A.H[3 + k] = A.H[3 + k] + add.y;
    A.H[6 + k] = A.H[6 + k] + add.z;
  }
  V3<V> b[3], a[3];
  for (int i = 0; i < 3; ++i) {
    b[i] = offset_cross<V>(r, before[i]);
    a[i] = offset_cross<V>(r, V3<V>{A.H[3 * i], A.H[3 * i + 1], A.H[3 * i + 2]});
  }
  A.I[0] = A.I[0] + (b[0].x + a[0].x);
  A.I[1] = A.I[1] + (b[1].x + a[0].y);
  A.I[2] = A.I[2] + (b[2].x + a[0].z);
  A.I[3] = A.I[3] + (b[1].y + a[1].y);
  A.I[4] = A.I[4] + (b[2].y + a[1].z);
  A.I[5] = A.I[5] + (b[2].z + a[2].z);
}

template <class V>
LANE_INLINE Inertia<V> own_inertia(const LaneJoint& j) {
  const V zero = Lane<V>::all(0.0), m = Lane<V>::all(j.mass);
  const V x = Lane<V>::all(j.moment[0]), y = Lane<V>::all(j.moment[1]), z = Lane<V>::all(j.moment[2]);
  Inertia<V> A;
  for (int i = 0; i < 6; ++i) A.I[i] = Lane<V>::all(j.inertia[i]);
  const V H[9] = {zero, -z, y, z, zero, -x, -y, x, zero};
  for (int i = 0; i < 9; ++i) A.H[i] = H[i];
  const V M[6] = {m, zero, zero, m, zero, m};
  for (int i = 0; i < 6; ++i) A.M[i] = M[i];
  return A;
}

// Eliminates a joint of 1 dof: stores W and D^-1, takes its part along the joint off A.
template <class V>
LANE_INLINE void eliminate_one(const Group<V>& g, const LaneJoint& j, V* factor, Inertia<V>& A) {
  V U[6];
  V D;
  if (j.type == kLaneSlide) {
    const V u[6] = {A.H[2], A.H[5], A.H[8], A.M[2], A.M[4], A.M[5]};
    for (int i = 0; i < 6; ++i) U[i] = u[i];
    D = U[5];
  } else {
    const V u[6] = {A.I[2], A.I[4], A.I[5], A.H[6], A.H[7], A.H[8]};
    for (int i = 0; i < 6; ++i) U[i] = u[i];
    D = U[2];
    if (j.type == kLaneScrew) {
      const V slide[6] = {A.H[2], A.H[5], A.H[8], A.M[2], A.M[4], A.M[5]};
      for (int i = 0; i < 6; ++i) U[i] = U[i] + j.pitch * slide[i];
      D = U[2] + j.pitch * U[5];
    }
  }
  const V inverse = 1.0 / (D + g.at(g.work->diagonal, j.dof));
  factor[6] = inverse;
  V W[6];
  for (int i = 0; i < 6; ++i) factor[i] = W[i] = U[i] * inverse;
  if (j.parent < 0) return;
  int k = 0;
  for (int r = 0; r < 3; ++r)
    for (int c = r; c < 3; ++c, ++k) {
      A.I[k] = A.I[k] - U[r] * W[c];
      A.M[k] = A.M[k] - U[3 + r] * W[3 + c];
    }
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) A.H[3 * r + c] = A.H[3 * r + c] - U[r] * W[3 + c];
}

// Inverse of a symmetric positive 3x3 by its cofactors.
template <class V>
LANE_INLINE void invert_symmetric(const V* D, V* inverse) {
  const V a = D[3] * D[5] - D[4] * D[4], b = D[2] * D[4] - D[1] * D[5], c = D[1] * D[4] - D[2] * D[3];
  const V scale = 1.0 / (D[0] * a + D[1] * b + D[2] * c);
  inverse[0] = a * scale;
  inverse[1] = b * scale;
  inverse[2] = c * scale;
  inverse[3] = (D[0] * D[5] - D[2] * D[2]) * scale;
  inverse[4] = (D[1] * D[2] - D[0] * D[4]) * scale;
  inverse[5] = (D[0] * D[3] - D[1] * D[1]) * scale;
}

template <class V>
LANE_INLINE void eliminate_three(const Group<V>& g, const LaneJoint& j, V* factor, Inertia<V>& A) {
  const bool ball = j.type == kLaneBall;
  V U[18], D[6], inverse[6], full[9];  // U: 6 x 3, row-major
  spread(ball ? A.I : A.M, full);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) {
      U[3 * r + c] = ball ? full[3 * r + c] : A.H[3 * r + c];
      U[9 + 3 * r + c] = ball ? A.H[3 * c + r] : full[3 * r + c];
    }
  for (int i = 0; i < 6; ++i) D[i] = ball ? A.I[i] : A.M[i];
  D[0] = D[0] + g.at(g.work->diagonal, j.dof);
  D[3] = D[3] + g.at(g.work->diagonal, j.dof + 1);
  D[5] = D[5] + g.at(g.work->diagonal, j.dof + 2);
  invert_symmetric(D, inverse);
  spread(inverse, full);
  V W[18];
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 3; ++c)
      factor[3 * r + c] = W[3 * r + c] = U[3 * r] * full[c] + U[3 * r + 1] * full[3 + c] + U[3 * r + 2] * full[6 + c];
  for (int i = 0; i < 6; ++i) factor[18 + i] = inverse[i];
  if (j.parent < 0) return;
  int k = 0;
  for (int r = 0; r < 3; ++r)
    for (int c = r; c < 3; ++c, ++k)
      for (int d = 0; d < 3; ++d) {
        A.I[k] = A.I[k] - U[3 * r + d] * W[3 * c + d];
        A.M[k] = A.M[k] - U[9 + 3 * r + d] * W[9 + 3 * c + d];
      }
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c)
      for (int d = 0; d < 3; ++d) A.H[3 * r + c] = A.H[3 * r + c] - U[3 * r + d] * W[9 + 3 * c + d];
}

template <class V>
LANE_INLINE void carry_inertia(const LaneJoint& j, const V* at, Inertia<V>& A) {
  if (j.type == kLaneBall) {
    turn_by(at, A);
  } else if (j.type == kLaneTranslate) {
    shift_by<V>(at, A);
    if (j.has_rotation) turn_by(j.C, A);
  } else {
    if (j.type != kLaneTurn) {
      const V zero = Lane<V>::all(0.0);
      const V up[3] = {zero, zero, at[2]};
      shift_by<V>(up, A);
    }
    turn_z(at[0], at[1], A);
    turn_alpha(j, A);
    if (j.has_gamma) turn_z(j.cos_gamma, j.sin_gamma, A);
  }
  shift_by<V>(j.r, A);
}

LANE_INLINE bool has_three(const LaneJoint& j) { return j.type == kLaneBall || j.type == kLaneTranslate; }

template <class V>
inline void factor_group(const Group<V>& g) {
  for (int i = g.tree->joints - 1; i >= 0; --i) {
    const LaneJoint& j = g.tree->joint[i];
    V* at = g.storage + j.at;
    V* factor = at + j.velocity + 9;
    Inertia<V> A = own_inertia<V>(j);
    if (j.slot >= 0) {
      const V* sum = g.slots + 21 * j.slot;
      for (int k = 0; k < 6; ++k) A.I[k] = A.I[k] + sum[k];
      for (int k = 0; k < 9; ++k) A.H[k] = A.H[k] + sum[6 + k];
      for (int k = 0; k < 6; ++k) A.M[k] = A.M[k] + sum[15 + k];
    }
    if (has_three(j)) {
      eliminate_three(g, j, factor, A);
    } else {
      eliminate_one(g, j, factor, A);
    }
    if (j.parent < 0) continue;
    carry_inertia(j, at, A);
    V* sum = g.slots + 21 * j.parent_slot;
    for (int k = 0; k < 6; ++k) sum[k] = j.first ? A.I[k] : sum[k] + A.I[k];
    for (int k = 0; k < 9; ++k) sum[6 + k] = j.first ? A.H[k] : sum[6 + k] + A.H[k];
    for (int k = 0; k < 6; ++k) sum[15 + k] = j.first ? A.M[k] : sum[15 + k] + A.M[k];
  }
}

// The component of (n, f) along the joint, for 1 dof.
template <class V>
LANE_INLINE V along(const LaneJoint& j, V3<V> n, V3<V> f) {
  if (j.type == kLaneTurn) return n.z;
  return j.type == kLaneSlide ? f.z : n.z + j.pitch * f.z;
}
