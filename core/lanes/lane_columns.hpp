// (M + diagonal)^-1 of many right sides side by side with the factor of a single stage: the lanes are the columns, and
// share the factor as numbers. The same operations in the same order as in lane_solve.hpp, so the bits agree. Included
// inside an unnamed namespace after lane_solve.hpp.

// u S and S.w of three numbers that all lanes share.
template <class V>
LANE_INLINE V3<V> spread_times(V u, const double* S) {
  return {u * S[0], u * S[1], u * S[2]};
}
template <class V>
LANE_INLINE V shared_dot(const double* S, V3<V> w) {
  return S[0] * w.x + S[1] * w.y + S[2] * w.z;
}

template <class V>
struct ColumnGroup {
  const LaneColumns* columns;
  int offset;  // of its first column
  V* slots;
  V* motion;  // angular and linear velocity of each body

  V at(int dof) const { return load<V>(columns->X + dof * columns->width + offset); }
  void put(int dof, V x) const { store<V>(columns->X + dof * columns->width + offset, x); }
  V3<V> at3(int dof) const { return {at(dof), at(dof + 1), at(dof + 2)}; }
  void put3(int dof, V3<V> x) const {
    put(dof, x.x);
    put(dof + 1, x.y);
    put(dof + 2, x.z);
  }
};

template <class V>
inline void columns_backward(const LaneTree* tree, const double* storage, const ColumnGroup<V>& g) {
  const V zero = Lane<V>::all(0.0);
  for (int k = g.columns->count - 1; k >= 0; --k) {
    const LaneJoint& j = tree->joint[g.columns->joints[k]];
    const double* at = storage + j.at;
    const double* W = at + j.velocity + 9;
    Force<V> a = {{zero, zero, zero}, {zero, zero, zero}};
    if (j.slot >= 0) a = {get3(g.slots + 6 * j.slot), get3(g.slots + 6 * j.slot + 3)};
    if (has_three(j)) {
      const V3<V> u = g.at3(j.dof) - (j.type == kLaneBall ? a.n : a.f);
      g.put3(j.dof, u);
      a = {a.n + times_matrix(W, u), a.f + times_matrix(W + 9, u)};
    } else {
      const V u = g.at(j.dof) - along(j, a.n, a.f);
      g.put(j.dof, u);
      a = {a.n + spread_times(u, W), a.f + spread_times(u, W + 3)};
    }
    if (j.parent < 0) continue;
    a = force_to_parent(j, at, a);
    V* sum = g.slots + 6 * j.parent_slot;
    if (!j.first) a = {a.n + get3(sum), a.f + get3(sum + 3)};
    put3(sum, a.n);
    put3(sum + 3, a.f);
  }
}

template <class V>
inline void columns_forward(const LaneTree* tree, const double* storage, const ColumnGroup<V>& g) {
  const V zero = Lane<V>::all(0.0);
  for (int k = 0; k < g.columns->count; ++k) {
    const int i = g.columns->joints[k];
    const LaneJoint& j = tree->joint[i];
    const double* at = storage + j.at;
    const double* W = at + j.velocity + 9;
    V3<V> w = {zero, zero, zero}, v = w;
    if (j.parent >= 0) {
      w = get3(g.motion + 6 * j.parent);
      v = get3(g.motion + 6 * j.parent + 3);
      velocity_into_body(j, at, w, v);
    }
    if (has_three(j)) {
      const double* D = W + 18;
      const double full[9] = {D[0], D[1], D[2], D[1], D[3], D[4], D[2], D[4], D[5]};
      const V3<V> x = times_matrix(full, g.at3(j.dof)) - (times_transpose(W, w) + times_transpose(W + 9, v));
      g.put3(j.dof, x);
      if (j.type == kLaneBall) {
        w = w + x;
      } else {
        v = v + x;
      }
    } else {
      const V x = g.at(j.dof) * W[6] - (shared_dot(W, w) + shared_dot(W + 3, v));
      g.put(j.dof, x);
      if (j.type != kLaneSlide) w.z = w.z + x;
      if (j.type != kLaneTurn) v.z = v.z + (j.type == kLaneSlide ? x : j.pitch * x);
    }
    put3(g.motion + 6 * i, w);
    put3(g.motion + 6 * i + 3, v);
  }
}

// The factor of coupled joints of a single stage.
template <class V>
struct ColumnCoupled {
  const LaneTree* tree;
  const double* rows;
  V* y;
  double U(int k, int dof) const { return rows[k * tree->nv + dof]; }
  double scaled(int k, int dof) const { return rows[(tree->followers + k) * tree->nv + dof]; }
  double inverse(int k, int j) const { return rows[tree->followers * (2 * tree->nv + k) + j]; }
  void store(int k, V x) const { y[k] = x; }
  V stored(int k) const { return y[k]; }
};

template <class V>
void solve_columns(const LaneTree* tree, const double* storage, const LaneColumns* columns) {
  V* work = reinterpret_cast<V*>(columns->work);
  const ColumnCoupled<V> coupled = {tree, columns->coupled, work + 6 * (tree->joints + tree->slots)};
  for (int offset = 0; offset < columns->width; offset += Lane<V>::count) {
    const ColumnGroup<V> g = {columns, offset, work + 6 * tree->joints, work};
    for (int k = 0; k < columns->coupling_count; ++k) fold(*tree, columns->couplings[k], g);
    columns_backward(tree, storage, g);
    for (int k = 0; k < columns->coupling_count; ++k) couple(*tree, columns->couplings[k], g, coupled);
    columns_forward(tree, storage, g);
    for (int k = 0; k < columns->coupling_count; ++k) follow(*tree, columns->couplings[k], g);
  }
}
