// One iteration on the stage equations of the Galerkin-Gauss step, all groups of lanes. Included inside an unnamed
// namespace after lane_solve.hpp.
//
// Chart X at q0, q_i = q0 (+) X_i, chart momentum px = J(X)^T p (1-dof and translation joints: J = 1):
//   X_i = h sum a_ij X'_j, X' = J^-1 v
//   px'_i = J^T (G_i + ad*_v p_i) + J'^T p_i,   p_i = J^-T (px_0 + h sum a_ij px'_j)
//   px_0 = J(X_1)^T p_1 - h sum b_j px'_j,  p_1 = exp(-X_1) (p_0 + h sum b_i exp(X_i) G_i)   (momentum balance)
// An iteration takes v, forms X, P = M v and G there, and corrects v by (M + diagonal)^-1 (p_i - P_i).

template <class V>
LANE_INLINE Group<V> group(const LaneTree* tree, const LaneWork* work, int index) {
  const int L = Lane<V>::count;
  V* storage = reinterpret_cast<V*>(work->storage) + index * tree->storage;
  return {tree, work, storage, reinterpret_cast<V*>(work->slots), index * L};
}

template <class V>
LANE_INLINE RunGroup<V> run_group(const LaneTree* tree, const LaneWork* work, int index) {
  return {group<V>(tree, work, index)};
}

template <class V>
LANE_INLINE int groups(const LaneWork* work) {
  return kOneStage ? 1 : work->S / Lane<V>::count;
}
LANE_INLINE int stages(const LaneWork& work) { return kOneStage ? 1 : work.s; }

// sum_j in[dof][j] hA[j][i]
template <class V>
LANE_INLINE V stage_sum(const Group<V>& g, const double* in, int dof) {
  typedef Memory<V> M;
  const LaneWork& w = *g.work;
  const double* row = in + dof * g.row();
  V sum = M::number(w, row) * M::get(w, w.hA + g.first());
  for (int j = 1; j < stages(w); ++j) sum = sum + M::number(w, row + j) * M::get(w, w.hA + j * g.row() + g.first());
  return sum;
}
template <class V>
LANE_INLINE V stage_sum(const RunGroup<V>& g, const double* in, int dof) {
  return g.at(in, dof) * g.at(g.work->hA, 0);
}

// sum_j hb[j] in[dof][j]
template <class V>
LANE_INLINE typename Memory<V>::Number end_sum(const Group<V>& g, const double* in, int dof) {
  typedef Memory<V> M;
  const LaneWork& w = *g.work;
  const double* row = in + dof * g.row();
  typename M::Number sum = M::number(w, w.hb) * M::number(w, row);
  for (int j = 1; j < stages(w); ++j) sum = sum + M::number(w, w.hb + j) * M::number(w, row + j);
  return sum;
}
template <class V>
LANE_INLINE V end_sum(const RunGroup<V>& g, const double* in, int dof) {
  return g.at(g.work->hb, 0) * g.at(in, dof);
}

template <class V>
void rates(const LaneTree* tree, const LaneWork* work) {
  for (int k = 0; k < groups<V>(work); ++k) {
    const Group<V> g = group<V>(tree, work, k);
    for (int i = 0; i < tree->joints; ++i) {
      const LaneJoint& j = tree->joint[i];
      if (j.type == kLaneBall) {
        g.put3(work->rate, j.dof, jacobian_inverse(rotation(g.at3(work->X, j.dof)), g.at3(work->v, j.dof)));
      } else if (work->rate != work->v) {
        for (int d = 0; d < (j.type == kLaneTranslate ? 3 : 1); ++d)
          g.put(work->rate, j.dof + d, g.at(work->v, j.dof + d));
      }
    }
  }
}

// X = hA X'. On balls, if measure, the change of X counts as an error, in energies of the joint.
template <bool measure, class G>
inline void displace(const G& g, int flags) {
  typedef typename G::Lanes V;
  const LaneWork& w = *g.work;
  V moved = Lane<V>::all(0.0);
  for (int i = 0; i < g.tree->joints; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    if (j.type == kLaneBall) {
      [[maybe_unused]] const V3<V> old = g.at3(w.X, j.dof);
      V3<V> X;
      X.x = stage_sum(g, w.rate, j.dof);
      X.y = stage_sum(g, w.rate, j.dof + 1);
      X.z = stage_sum(g, w.rate, j.dof + 2);
      g.put3(w.X, j.dof, X);
      if constexpr (measure) {
        const V3<V> change = X - old, rate = g.at3(w.v, j.dof), p = g.at3(w.P, j.dof);
        if (!(flags & kLaneFirst))
          moved = moved +
                  absolute(dot(p, rate)) * dot(change, change) / (dot(rate, rate) * (g.length() * g.length()) + 1e-300);
      }
    } else {
      for (int d = 0; d < (j.type == kLaneTranslate ? 3 : 1); ++d)
        g.put(w.X, j.dof + d, stage_sum(g, w.rate, j.dof + d));
    }
  }
  if constexpr (measure) store<V>(w.error + g.first(), moved);
}

// Rates of the chart momentum of the balls, and exp(X) G for the balance.
template <class V>
inline void ball_rates(const Group<V>& g) {
  const LaneWork& w = *g.work;
  for (int i = 0; i < g.tree->joints; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    if (j.type != kLaneBall) continue;
    const Rotation<V> k = rotation(g.at3(w.X, j.dof));
    const V3<V> G = g.at3(w.G, j.dof), P = g.at3(w.P, j.dof), v = g.at3(w.v, j.dof);
    const V3<V> rate = jacobian_inverse(k, v);
    const V3<V> px = jacobian_transpose(k, G + cross(P, v)) + jacobian_rate_transpose(k, rate, P);
    g.put3(w.px, j.dof, px);
    g.put3(w.Y, j.dof, exp_apply(k, G));
  }
}

template <class G>
LANE_INLINE auto end_sum3(const G& g, const double* in, int dof) -> V3<decltype(end_sum(g, in, dof))> {
  return {end_sum(g, in, dof), end_sum(g, in, dof + 1), end_sum(g, in, dof + 2)};
}

// Chart momentum of a ball at the start of the step.
template <class G>
LANE_INLINE auto ball_start(const G& g, int dof) -> decltype(end_sum3(g, g.work->px, dof)) {
  typedef decltype(end_sum(g, g.work->px, dof)) N;
  const LaneWork& w = *g.work;
  const V3<N> p0 = {g.number(w.p0, dof), g.number(w.p0, dof + 1), g.number(w.p0, dof + 2)};
  const V3<N> X1 = end_sum3(g, w.rate, dof);
  const Rotation<N> back = rotation(times(-1.0, X1)), k = rotation(X1);
  const V3<N> p1 = exp_apply(back, p0 + end_sum3(g, w.Y, dof));
  return jacobian_transpose(k, p1) - end_sum3(g, w.px, dof);
}

template <class G>
inline void residuals(const G& g) {
  typedef typename G::Lanes V;
  const LaneWork& w = *g.work;
  for (int i = 0; i < g.tree->joints; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    if (j.type == kLaneBall) {
      const auto start = ball_start(g, j.dof);
      V3<V> px;
      px.x = start.x + stage_sum(g, w.px, j.dof);
      px.y = start.y + stage_sum(g, w.px, j.dof + 1);
      px.z = start.z + stage_sum(g, w.px, j.dof + 2);
      if (w.impulse) px = px + g.at3(w.impulse, j.dof);
      const V3<V> p = jacobian_inverse_transpose(rotation(g.at3(w.X, j.dof)), px);
      g.put3(w.dv, j.dof, p - g.at3(w.P, j.dof));
    } else {
      for (int d = j.dof; d < j.dof + (j.type == kLaneTranslate ? 3 : 1); ++d)
        g.put(w.dv, d, (g.number(w.p0, d) + stage_sum(g, w.G, d)) - g.at(w.P, d));
      if (w.impulse)
        for (int d = j.dof; d < j.dof + (j.type == kLaneTranslate ? 3 : 1); ++d)
          g.put(w.dv, d, g.at(w.dv, d) + g.at(w.impulse, d));
    }
  }
}

// Of a joint of one dof, by the factor.
template <class G>
LANE_INLINE typename G::Lanes inverse_inertia(const G& g, int joint) {
  const LaneJoint& j = g.tree->joint[joint];
  return g.storage[j.at + j.velocity + 9 + 6];
}

// Energies of the impulses of the single forces, sum (h |force|)^2 / D: what differs by less is rounding, not motion.
template <class G>
inline void measure_impulses(const G& g) {
  typedef typename G::Lanes V;
  const LaneWork& w = *g.work;
  V sum = Lane<V>::all(0.0);
  for (int i = 0; i < g.tree->joints; ++i) {
    const LaneJoint& j = g.tree->joint[i];
    if (j.coupled) continue;
    const V* factor = g.storage + j.at + j.velocity + 9;
    const int three[3] = {18, 21, 23};
    for (int d = 0; d < (has_three(j) ? 3 : 1); ++d) {
      const V impulse = g.length() * g.at(w.magnitude, j.dof + d);
      sum = sum + impulse * impulse * factor[has_three(j) ? three[d] : 6];
    }
  }
  // A leader has the forces and the inertia of its followers, too.
  for (int i = 0; i < g.tree->leaders; ++i) {
    const LaneLeader& leader = g.tree->leader[i];
    V size = g.at(g.work->magnitude, leader.dof), inertia = 1.0 / inverse_inertia(g, leader.joint);
    for (int t = leader.first; t < leader.first + leader.count; ++t) {
      const LaneTerm& term = g.tree->term[t];
      const double ratio = term.ratio < 0.0 ? -term.ratio : term.ratio;
      size = size + ratio * g.at(g.work->magnitude, term.dof);
      inertia = inertia + ratio * ratio / inverse_inertia(g, term.joint);
    }
    const V impulse = g.length() * size;
    sum = sum + impulse * impulse / inertia;
  }
  store<V>(w.impulse_energy + g.first(), sum);
}

template <class G>
inline void correct(const G& g, int flags) {
  typedef typename G::Lanes V;
  const LaneWork& w = *g.work;
  if (flags & kLaneFactor) {
    // The impulses' energies need M's factor, which a Newton step needs for nothing else.
    if (!(flags & kLaneNewton) || (flags & kLaneFirst)) {
      factor_group(g);
      measure_impulses(g);
    }
    if (flags & kLaneNewton) factor_newton(g);
    if (g.tree->couplings > 0) {
      if (!(flags & kLaneNewton) || (flags & kLaneFirst)) factor_coupled(g);
      if (flags & kLaneNewton) factor_coupled_newton(g);
    }
  }
  fold_all(g, w.dv);
  // The residual is needed again after the solve overwrites it; the magnitudes are not, so it takes their array.
  for (int dof = 0; dof < g.tree->nv; ++dof) g.put(w.magnitude, dof, g.at(w.dv, dof));
  if (flags & kLaneNewton) {
    solve_newton_group(g);
  } else {
    solve_group(g);
  }
  V error = load<V>(w.error + g.first()), kinetic = Lane<V>::all(0.0);
  for (int dof = 0; dof < g.tree->nv; ++dof) {
    const V dv = g.at(w.dv, dof), v = g.at(w.v, dof);
    error = error + g.at(w.magnitude, dof) * dv;
    kinetic = kinetic + g.at(w.P, dof) * v;
    if (!(flags & kLaneKeepVelocity)) g.put(w.v, dof, v + dv);
  }
  if (!(flags & kLaneKeepVelocity)) follow_all(g, w.v);
  store<V>(w.error + g.first(), error);
  store<V>(w.kinetic + g.first(), kinetic);
}

// make(k): the group k of lanes.
template <class V, class Make>
LANE_INLINE void iterate_groups(const LaneTree* tree, const LaneWork* work, int flags, Make make) {
  const int count = groups<V>(work);
  if (tree->couplings > 0)
    for (int k = 0; k < count; ++k) {
      const auto g = make(k);
      follow_all(g, work->v);
    }
  if (tree->balls > 0) {
    // X' depends on X: iterated once more, so that its error does not slow down the iterations on v.
    rates<V>(tree, work);
    for (int k = 0; k < count; ++k) displace<true>(make(k), kLaneFirst);
    rates<V>(tree, work);
  }
  for (int k = 0; k < count; ++k) {
    const auto g = make(k);
    displace<true>(g, tree->balls > 0 ? flags & ~kLaneFirst : flags);
    forward(g);
    if (flags & kLaneFactor) {
      backward<true>(g);
    } else {
      backward<false>(g);
    }
  }
  if (work->extra) work->extra(work->context);
  if (tree->balls > 0)
    for (int k = 0; k < count; ++k) ball_rates(group<V>(tree, work, k));
  for (int k = 0; k < count; ++k) {
    const auto g = make(k);
    residuals(g);
    correct(g, flags);
  }
}

template <class V>
void iterate(const LaneTree* tree, const LaneWork* work, int flags) {
  iterate_groups<V>(tree, work, flags, [=](int k) { return group<V>(tree, work, k); });
}

template <class V>
void iterate_runs(const LaneTree* tree, const LaneWork* work, int flags) {
  iterate_groups<V>(tree, work, flags, [=](int k) { return run_group<V>(tree, work, k); });
}

template <class V>
void solve_runs(const LaneTree* tree, const LaneWork* work) {
  for (int k = 0; k < groups<V>(work); ++k) {
    const RunGroup<V> g = run_group<V>(tree, work, k);
    place_all(g);
    factor_group(g);
    if (tree->couplings > 0) factor_coupled(g);
    solve_group(g);
  }
}

// The stage equations' residuals and their derivatives along the direction in the shadows; v and its derivative stay.
template <class V>
void tangent(const LaneTree* tree, const LaneWork* work) {
  typedef Dual<V> D;
  const int count = groups<V>(work);
  if (tree->balls > 0) {
    rates<D>(tree, work);
    for (int k = 0; k < count; ++k) displace<false>(group<D>(tree, work, k), kLaneFirst);
    rates<D>(tree, work);
  }
  for (int k = 0; k < count; ++k) {
    const Group<D> g = group<D>(tree, work, k);
    displace<false>(g, kLaneFirst);
    forward(g);
    backward<false>(g);
  }
  if (work->extra) work->extra(work->context);
  if (tree->balls > 0)
    for (int k = 0; k < count; ++k) ball_rates(group<D>(tree, work, k));
  for (int k = 0; k < count; ++k) residuals(group<D>(tree, work, k));
}

template <class V>
void evaluate(const LaneTree* tree, const LaneWork* work) {
  for (int k = 0; k < groups<V>(work); ++k) {
    const Group<V> g = group<V>(tree, work, k);
    forward(g);
    backward<false>(g);
  }
}

template <class V>
void evaluate_tangent(const LaneTree* tree, const LaneWork* work) {
  evaluate<Dual<V>>(tree, work);
}

template <class V>
void evaluate_second(const LaneTree* tree, const LaneWork* work) {
  evaluate<Dual<Dual<V>>>(tree, work);
}

template <class V>
void place_stages(const LaneTree* tree, const LaneWork* work) {
  for (int k = 0; k < groups<V>(work); ++k) place_all(group<V>(tree, work, k));
}

template <class V>
void factor_stages(const LaneTree* tree, const LaneWork* work) {
  for (int k = 0; k < groups<V>(work); ++k) {
    const Group<V> g = group<V>(tree, work, k);
    factor_group(g);
    if (tree->couplings > 0) factor_coupled(g);
  }
}

template <class V>
void solve_stages(const LaneTree* tree, const LaneWork* work) {
  for (int k = 0; k < groups<V>(work); ++k) {
    solve_group(group<V>(tree, work, k));
  }
}

template <class V>
void combine(int nv, int s, int S, const double* weight, const double* in, double* out, bool add) {
  for (int dof = 0; dof < nv; ++dof)
    for (int offset = 0; offset < S; offset += Lane<V>::count) {
      const double* row = in + dof * S;
      V sum = row[0] * load<V>(weight + offset);
      for (int j = 1; j < s; ++j) sum = sum + row[j] * load<V>(weight + j * S + offset);
      store<V>(out + dof * S + offset, add ? load<V>(out + dof * S + offset) + sum : sum);
    }
}

// fixed: the number of inner ones where it is known, else 0.
template <class V, int fixed>
LANE_INLINE void subtract_inner(int rows, int given, int width, const double* A, int stride, const double* X, double* Y,
                                bool anew) {
  const int inner = fixed > 0 ? fixed : given;
  for (int at = 0; at < width; at += Lane<V>::count) {
    V x[8];
    for (int k = 0; k < inner; ++k) x[k] = load<V>(X + k * width + at);
    for (int i = 0; i < rows; ++i) {
      V sum = anew ? Lane<V>::all(0.0) : load<V>(Y + i * width + at);
      for (int k = 0; k < inner; ++k) sum = sum - A[i * stride + k] * x[k];
      store<V>(Y + i * width + at, sum);
    }
  }
}

template <class V>
void subtract_product(int rows, int inner, int width, const double* A, int stride, const double* X, double* Y,
                      bool anew) {
  if (inner == 1 && rows == 1) {
    subtract_inner<V, 1>(1, 1, width, A, stride, X, Y, anew);
  } else if (inner == 8) {
    subtract_inner<V, 8>(rows, 8, width, A, stride, X, Y, anew);
  } else {
    subtract_inner<V, 0>(rows, inner, width, A, stride, X, Y, anew);
  }
}

template <class V>
void extrapolate_runs(int rows, const double* const* past, const double* const* weight, double* out) {
  const int L = Lane<V>::count;
  const V wa = load<V>(weight[0]), wb = load<V>(weight[1]), wc = load<V>(weight[2]), wd = load<V>(weight[3]);
  const double *a = past[0], *b = past[1], *c = past[2], *d = past[3];
  for (int i = 0; i < rows * L; i += L)
    store<V>(out + i, load<V>(a + i) * wa + load<V>(b + i) * wb + load<V>(c + i) * wc + load<V>(d + i) * wd);
}

template <class V>
void add_runs(int rows, const double* weight, const double* rate, double* base, double* carry, double* end,
              double* lost) {
  const int L = Lane<V>::count;
  const V w = load<V>(weight);
  for (int i = 0; i < rows * L; i += L) {
    const V start = load<V>(base + i), change = w * load<V>(rate + i) + load<V>(carry + i), total = start + change;
    const V rest = change - (total - start);
    store<V>(carry + i, rest);
    store<V>(lost + i, rest);
    store<V>(base + i, total);
    store<V>(end + i, total);
  }
}

template <class V>
constexpr LaneKernel lane_kernel() {
  return {Lane<V>::count,      evaluate<V>,        place_stages<V>,    factor_stages<V>, solve_stages<V>,
          solve_columns<V>,    iterate<V>,         rates<V>,           combine<V>,       tangent<V>,
          evaluate_tangent<V>, evaluate_second<V>, subtract_product<V>};
}

template <class V>
constexpr RunKernel run_kernel() {
  return {Lane<V>::count, iterate_runs<V>, rates<V>, solve_runs<V>, extrapolate_runs<V>, add_runs<V>};
}
