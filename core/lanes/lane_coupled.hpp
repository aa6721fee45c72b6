// Coupled joints: the velocities are v = S u, those of the followers sums of ratios times those of their leaders.
// Included inside an unnamed namespace after lane_solve.hpp.
//
// With C the complement, a column e_follower - sum ratio e_leader for each follower, S^T C = 0 and
//   S (S^T D S)^-1 S^T = D^-1 - Z (C^T Z)^-1 C^T D^-1,   Z = D^-1 C,
// for every D that has an inverse, symmetric or not: so the factor of D along the tree serves the coupled joints, too.
// Z and K^-1 = (C^T Z)^-1 are kept with it. A right side r counts as S^T r alone: it is folded first, which puts what
// acts on a follower on its leaders, so that the reaction between them is no part of the numbers that are solved for.

// a <- what S^T a is of the leaders, 0 of the followers. Array: at(dof), put(dof, x).
template <class Array>
LANE_INLINE void fold(const LaneTree& tree, int coupling, const Array& a) {
  const LaneCoupling& c = tree.coupling[coupling];
  for (int k = c.first; k < c.first + c.count; ++k) {
    const LaneFollower& f = tree.follower[k];
    const auto own = a.at(f.dof);
    for (int t = f.first; t < f.first + f.count; ++t) {
      const LaneTerm& term = tree.term[t];
      a.put(term.dof, a.at(term.dof) + term.ratio * own);
    }
    a.put(f.dof, 0.0 * own);
  }
}

// What the leaders of a follower give it.
template <class Array>
LANE_INLINE auto led(const LaneTree& tree, const LaneFollower& f, const Array& a) -> decltype(a.at(0)) {
  const LaneTerm* term = tree.term + f.first;
  auto sum = term->ratio * a.at(term->dof);
  for (int t = 1; t < f.count; ++t) sum = sum + term[t].ratio * a.at(term[t].dof);
  return sum;
}

// Followers take the numbers that their leaders give them.
template <class Array>
LANE_INLINE void follow(const LaneTree& tree, int coupling, const Array& a) {
  const LaneCoupling& c = tree.coupling[coupling];
  for (int k = c.first; k < c.first + c.count; ++k) a.put(tree.follower[k].dof, led(tree, tree.follower[k], a));
}

// x <- x - Z K^-1 C^T x for x = D^-1 r, and the followers exactly from their leaders. Factor: Z(k, dof), inverse(k, j)
// and a workspace of a number for each follower, store(k, y) and stored(k).
template <class Array, class Factor>
LANE_INLINE void project(const LaneTree& tree, int coupling, const Array& x, const Factor& factor) {
  const LaneCoupling& c = tree.coupling[coupling];
  const int end = c.first + c.count;
  for (int k = c.first; k < end; ++k) factor.store(k, x.at(tree.follower[k].dof) - led(tree, tree.follower[k], x));
  for (int k = c.first; k < end; ++k) {
    auto y = factor.inverse(k, c.first) * factor.stored(c.first);
    for (int j = c.first + 1; j < end; ++j) y = y + factor.inverse(k, j) * factor.stored(j);
    for (int d = c.dof; d < c.dof_end; ++d) x.put(d, x.at(d) - factor.Z(k, d) * y);
  }
  follow(tree, coupling, x);
}

// An array over dofs and stages, of one group of lanes.
template <class V>
struct StageArray {
  const Group<V>* g;
  double* array;
  V at(int dof) const { return g->at(array, dof); }
  void put(int dof, V x) const { g->put(array, dof, x); }
};

// The factor of coupled joints, [(follower * nv + dof) * S + stage] and so on.
template <class V>
struct StageCoupled {
  const Group<V>* g;
  double* rows;
  int first_inverse() const { return g->tree->followers * g->tree->nv; }
  int first_stored() const { return g->tree->followers * (g->tree->nv + g->tree->followers); }
  V Z(int k, int dof) const { return g->at(rows, k * g->tree->nv + dof); }
  double* column(int k) const { return rows + k * g->tree->nv * g->row(); }
  V inverse(int k, int j) const { return g->at(rows, first_inverse() + k * g->tree->followers + j); }
  void put_inverse(int k, int j, V x) const { g->put(rows, first_inverse() + k * g->tree->followers + j, x); }
  void store(int k, V x) const { g->put(rows, first_stored() + k, x); }
  V stored(int k) const { return g->at(rows, first_stored() + k); }
};

// Of the mass matrix; of Newton's matrix.
template <class V>
LANE_INLINE StageCoupled<V> coupled_factor(const Group<V>& g, bool newton) {
  return {&g, g.work->coupled + (newton ? coupled_rows(*g.tree) * g.row() : 0)};
}

template <class V>
LANE_INLINE void fold_all(const Group<V>& g, double* array) {
  for (int c = 0; c < g.tree->couplings; ++c) fold(*g.tree, c, StageArray<V>{&g, array});
}
template <class V>
LANE_INLINE void follow_all(const Group<V>& g, double* array) {
  for (int c = 0; c < g.tree->couplings; ++c) follow(*g.tree, c, StageArray<V>{&g, array});
}
template <class V>
LANE_INLINE void project_all(const Group<V>& g, bool newton) {
  for (int c = 0; c < g.tree->couplings; ++c)
    project(*g.tree, c, StageArray<V>{&g, g.work->dv}, coupled_factor(g, newton));
}

// dv <- S (S^T D S)^-1 S^T dv, D = M + diagonal; without coupled joints D^-1 dv.
template <class V>
inline void solve_group(const Group<V>& g) {
  fold_all(g, g.work->dv);
  solve_backward(g, 0, g.tree->joints);
  solve_forward(g, 0, g.tree->joints);
  project_all(g, false);
}
