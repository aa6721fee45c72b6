// The factor of coupled joints (lane_coupled.hpp), made after that of the tree. Included inside an unnamed namespace
// after lane_newton.hpp.

template <class V>
inline void solve_newton_group(const Group<V>& g) {
  fold_all(g, g.work->dv);
  solve_newton_backward(g, 0, g.tree->joints);
  solve_newton_forward(g, 0, g.tree->joints);
  project_all(g, true);
}

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

// Z = D^-1 C, K = C^T Z and K^-1. The velocities of the bodies in the storage are overwritten.
template <class V>
inline void factor_coupled(const Group<V>& g, bool newton) {
  const LaneTree& tree = *g.tree;
  const StageCoupled<V> factor = coupled_factor(g, newton);
  LaneWork work = *g.work;
  Group<V> column = g;
  column.work = &work;
  for (int i = 0; i < tree.couplings; ++i) {
    const LaneCoupling& c = tree.coupling[i];
    for (int k = c.first; k < c.first + c.count; ++k) {
      const LaneFollower& f = tree.follower[k];
      work.dv = factor.column(k);
      for (int d = c.dof; d < c.dof_end; ++d) g.put(work.dv, d, Lane<V>::all(0.0));
      for (int t = f.first; t < f.first + f.count; ++t)
        g.put(work.dv, tree.term[t].dof, Lane<V>::all(-tree.term[t].ratio));
      g.put(work.dv, f.dof, Lane<V>::all(1.0));
      if (newton) {
        solve_newton_backward(column, c.joint, c.joint_end);
        solve_newton_forward(column, c.joint, c.joint_end);
      } else {
        solve_backward(column, c.joint, c.joint_end);
        solve_forward(column, c.joint, c.joint_end);
      }
      const StageArray<V> Z = {&g, work.dv};
      for (int j = c.first; j < c.first + c.count; ++j)
        factor.put_inverse(j, k, Z.at(tree.follower[j].dof) - led(tree, tree.follower[j], Z));
    }
    invert_coupling(c, factor);
  }
}
