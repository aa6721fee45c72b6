// The factor of coupled joints (lane_coupled.hpp), made after that of the tree. Included inside an unnamed namespace
// after lane_newton.hpp.

// K^-1 of a coupling in the place of K, by Gauss and Jordan. No rows are exchanged, since all lanes do the same: K is
// positive, or near to what is.
template <class V>
inline void invert_coupling(const LaneCoupling& c, const StageCoupled<V>& factor) {
  const int first = c.first, end = c.first + c.count;
  for (int p = first; p < end; ++p) {
    const V pivot = 1.0 / factor.inverse(p, p);
    factor.put_inverse(p, p, Lane<V>::all(1.0));
    for (int j = first; j < end; ++j) factor.put_inverse(p, j, factor.inverse(p, j) * pivot);
    for (int i = first; i < end; ++i) {
      if (i == p) continue;
      const V share = factor.inverse(i, p);
      factor.put_inverse(i, p, Lane<V>::all(0.0));
      for (int j = first; j < end; ++j) factor.put_inverse(i, j, factor.inverse(i, j) - share * factor.inverse(p, j));
    }
  }
}

// The column C of a follower in the rows of a factor.
template <class V>
LANE_INLINE void put_complement(const Group<V>& g, const LaneFollower& f, double* column) {
  for (int t = f.first; t < f.first + f.count; ++t)
    g.put(column, g.tree->term[t].dof, Lane<V>::all(-g.tree->term[t].ratio));
  g.put(column, f.dof, Lane<V>::all(1.0));
}

// U and B^-1 U of a follower, by the backward pass along its path. The forces between bodies stand where their
// velocities do.
template <class V>
inline void eliminate_follower(const Group<V>& g, int k, const StageCoupled<V>& factor) {
  const LaneTree& tree = *g.tree;
  const LaneFollower& f = tree.follower[k];
  const int* path = tree.path + f.path;
  const V zero = Lane<V>::all(0.0);
  const V3<V> none = {zero, zero, zero};
  double* U = factor.column(k);
  for (int i = 0; i < f.dofs; ++i) g.put(U, path[f.joints + i], zero);
  put_complement(g, f, U);
  for (int i = 0; i < f.joints; ++i) {
    const LaneJoint& j = tree.joint[path[i]];
    put3(g.storage + j.at + j.velocity, none);
    put3(g.storage + j.at + j.velocity + 3, none);
  }
  for (int i = f.joints - 1; i >= 0; --i) {
    const LaneJoint& j = tree.joint[path[i]];
    const V* at = g.storage + j.at;
    const V* W = at + j.velocity + 9;
    Force<V> a = {get3(at + j.velocity), get3(at + j.velocity + 3)};
    if (has_three(j)) {
      const V* D = W + 18;
      const V full[9] = {D[0], D[1], D[2], D[1], D[3], D[4], D[2], D[4], D[5]};
      const V3<V> u = g.at3(U, j.dof) - (j.type == kLaneBall ? a.n : a.f), scaled = times_matrix(full, u);
      g.put3(U, j.dof, u);
      factor.put_scaled(k, j.dof, scaled.x);
      factor.put_scaled(k, j.dof + 1, scaled.y);
      factor.put_scaled(k, j.dof + 2, scaled.z);
      a = {a.n + times_matrix(W, u), a.f + times_matrix(W + 9, u)};
    } else {
      const V u = g.at(U, j.dof) - along(j, a.n, a.f);
      g.put(U, j.dof, u);
      factor.put_scaled(k, j.dof, u * W[6]);
      a = {a.n + times(u, get3(W)), a.f + times(u, get3(W + 3))};
    }
    if (j.parent < 0) continue;
    a = force_to_parent(j, at, a);
    const LaneJoint& parent = tree.joint[j.parent];
    V* sum = g.storage + parent.at + parent.velocity;
    put3(sum, get3(sum) + a.n);
    put3(sum + 3, get3(sum + 3) + a.f);
  }
}

// U, B^-1 U and K^-1 of the mass matrix. The velocities of the bodies in the storage are overwritten.
template <class V>
inline void factor_coupled(const Group<V>& g) {
  const LaneTree& tree = *g.tree;
  const StageCoupled<V> factor = coupled_factor(g, false);
  for (int i = 0; i < tree.couplings; ++i) {
    const LaneCoupling& c = tree.coupling[i];
    const int end = c.first + c.count;
    for (int k = c.first; k < end; ++k) eliminate_follower(g, k, factor);
    for (int k = c.first; k < end; ++k)
      for (int j = c.first; j <= k; ++j) {
        // Both paths ascend: where they have a dof in common.
        const LaneFollower &a = tree.follower[j], &b = tree.follower[k];
        const int *p = tree.path + a.path + a.joints, *q = tree.path + b.path + b.joints;
        V sum = Lane<V>::all(0.0);
        for (int s = 0, t = 0; s < a.dofs && t < b.dofs;) {
          if (p[s] == q[t]) {
            sum = sum + factor.U(j, p[s]) * factor.scaled(k, q[t]);
            ++s;
            ++t;
          } else if (p[s] < q[t]) {
            ++s;
          } else {
            ++t;
          }
        }
        factor.put_inverse(j, k, sum);
        factor.put_inverse(k, j, sum);
      }
    invert_coupling(c, factor);
  }
}

// Of Newton's matrix, which is not symmetric: Z = D^-1 C in the place of U, and K^-1.
template <class V>
inline void factor_coupled_newton(const Group<V>& g) {
  const LaneTree& tree = *g.tree;
  const StageCoupled<V> factor = coupled_factor(g, true);
  LaneWork work = *g.work;
  Group<V> column = g;
  column.work = &work;
  for (int i = 0; i < tree.couplings; ++i) {
    const LaneCoupling& c = tree.coupling[i];
    for (int k = c.first; k < c.first + c.count; ++k) {
      work.dv = factor.column(k);
      for (int d = c.dof; d < c.dof_end; ++d) g.put(work.dv, d, Lane<V>::all(0.0));
      put_complement(g, tree.follower[k], work.dv);
      solve_newton_backward(column, c.joint, c.joint_end);
      solve_newton_forward(column, c.joint, c.joint_end);
      const StageArray<V> Z = {&g, work.dv};
      for (int j = c.first; j < c.first + c.count; ++j)
        factor.put_inverse(j, k, Z.at(tree.follower[j].dof) - led(tree, tree.follower[j], Z));
    }
    invert_coupling(c, factor);
  }
}

// x <- x - Z K^-1 C^T x for x = D^-1 r.
template <class V>
LANE_INLINE void project(const Group<V>& g, const LaneCoupling& c) {
  const LaneTree& tree = *g.tree;
  const StageArray<V> x = {&g, g.work->dv};
  const StageCoupled<V> factor = coupled_factor(g, true);
  const int end = c.first + c.count;
  for (int k = c.first; k < end; ++k) factor.store(k, x.at(tree.follower[k].dof) - led(tree, tree.follower[k], x));
  for (int k = c.first; k < end; ++k) {
    V y = factor.inverse(k, c.first) * factor.stored(c.first);
    for (int j = c.first + 1; j < end; ++j) y = y + factor.inverse(k, j) * factor.stored(j);
    for (int d = c.dof; d < c.dof_end; ++d) x.put(d, x.at(d) - factor.U(k, d) * y);
  }
}

template <class V>
inline void solve_newton_group(const Group<V>& g) {
  fold_all(g, g.work->dv);
  solve_newton_backward(g, 0, g.tree->joints);
  solve_newton_forward(g, 0, g.tree->joints);
  for (int c = 0; c < g.tree->couplings; ++c) project(g, g.tree->coupling[c]);
  follow_all(g, g.work->dv);
}
