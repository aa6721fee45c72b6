// Coupled joints: the velocities are v = S u, those of the followers sums of ratios times those of their leaders.
// Included inside an unnamed namespace after lane_solve.hpp.
//
// With C the complement, a column e_follower - sum ratio e_leader for each follower, S^T C = 0 and
//   S (S^T D S)^-1 S^T = D^-1 - Z K^-1 C^T D^-1,   Z = D^-1 C, K = C^T Z,
// for every D that has an inverse, symmetric or not: so the factor of D along the tree serves the coupled joints, too.
// A right side r counts as S^T r alone: it is folded first, which puts what acts on a follower on its leaders, so that
// the reaction between them is no part of the numbers that are solved for.

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

// For D = L^T B L, as the factor along the tree has it, between its backward and its forward pass:
// x <- x - U y with y = K^-1 V^T x, where U = L^-T C, V = B^-1 U and K = C^T D^-1 C = U^T V. A column of U has numbers
// on the path of its follower alone. Factor: U(k, dof), scaled(k, dof) of V, inverse(k, j), and a workspace of a number
// for each follower, store(k, y) and stored(k).
template <class Array, class Factor>
LANE_INLINE void couple(const LaneTree& tree, int coupling, const Array& x, const Factor& factor) {
  const LaneCoupling& c = tree.coupling[coupling];
  const int end = c.first + c.count;
  for (int k = c.first; k < end; ++k) {
    const LaneFollower& f = tree.follower[k];
    const int* dof = tree.path + f.path + f.joints;
    auto y = factor.scaled(k, dof[0]) * x.at(dof[0]);
    for (int i = 1; i < f.dofs; ++i) y = y + factor.scaled(k, dof[i]) * x.at(dof[i]);
    factor.store(k, y);
  }
  for (int k = c.first; k < end; ++k) {
    auto y = factor.inverse(k, c.first) * factor.stored(c.first);
    for (int j = c.first + 1; j < end; ++j) y = y + factor.inverse(k, j) * factor.stored(j);
    const LaneFollower& f = tree.follower[k];
    const int* dof = tree.path + f.path + f.joints;
    for (int i = 0; i < f.dofs; ++i) x.put(dof[i], x.at(dof[i]) - factor.U(k, dof[i]) * y);
  }
}

// An array over dofs and stages, of one group of lanes.
template <class V>
struct StageArray {
  const Group<V>* g;
  double* array;
  LANE_INLINE V at(int dof) const { return g->at(array, dof); }
  LANE_INLINE void put(int dof, V x) const { g->put(array, dof, x); }
};

// The factor of coupled joints, [(follower * nv + dof) * S + stage] and so on.
template <class V>
struct StageCoupled {
  const Group<V>* g;
  double* rows;
  LANE_INLINE int count() const { return g->tree->followers; }
  LANE_INLINE V U(int k, int dof) const { return g->at(rows, k * g->tree->nv + dof); }
  LANE_INLINE double* column(int k) const { return rows + k * g->tree->nv * g->row(); }
  LANE_INLINE V scaled(int k, int dof) const { return g->at(rows, (count() + k) * g->tree->nv + dof); }
  LANE_INLINE void put_scaled(int k, int dof, V x) const { g->put(rows, (count() + k) * g->tree->nv + dof, x); }
  LANE_INLINE V inverse(int k, int j) const { return g->at(rows, count() * (2 * g->tree->nv + k) + j); }
  LANE_INLINE void put_inverse(int k, int j, V x) const { g->put(rows, count() * (2 * g->tree->nv + k) + j, x); }
  LANE_INLINE void store(int k, V x) const { g->put(rows, count() * (2 * g->tree->nv + count()) + k, x); }
  LANE_INLINE V stored(int k) const { return g->at(rows, count() * (2 * g->tree->nv + count()) + k); }
};

// Of the mass matrix; of Newton's matrix.
template <class V>
LANE_INLINE StageCoupled<V> coupled_factor(const Group<V>& g, bool newton) {
  return {&g, g.work->coupled + (newton ? coupled_rows(*g.tree) * g.row() : 0)};
}

template <class V>
LANE_INLINE void fold_all(const Group<V>& g, double* array) {
  const StageArray<V> a = {&g, array};
  for (int c = 0; c < g.tree->couplings; ++c) fold(*g.tree, c, a);
}
template <class V>
LANE_INLINE void follow_all(const Group<V>& g, double* array) {
  const StageArray<V> a = {&g, array};
  for (int c = 0; c < g.tree->couplings; ++c) follow(*g.tree, c, a);
}
template <class V>
LANE_INLINE void couple_all(const Group<V>& g) {
  for (int c = 0; c < g.tree->couplings; ++c) {
    const StageArray<V> x = {&g, g.work->dv};
    const StageCoupled<V> factor = coupled_factor(g, false);
    couple(*g.tree, c, x, factor);
  }
}

// dv <- S (S^T D S)^-1 S^T dv, D = M + diagonal; without coupled joints D^-1 dv.
template <class V>
inline void solve_group(const Group<V>& g) {
  fold_all(g, g.work->dv);
  solve_backward(g);
  couple_all(g);
  solve_forward(g);
  follow_all(g, g.work->dv);
}
