// What a run leaves behind: nodes, impacts, the polynomials of its steps. Engine coordinates.
#pragma once

#include <vector>

#include "numerics.hpp"

namespace contactvi {

struct ImpactRecord {
  double time;
  int guard;
  Vec3 point, normal;
  double impulse, gamma_minus, gamma_plus, G_c, gap, restitution;
  int method, iterations, fallback;
  double jump;           // left over in the map's own energy equation [J]
  double before, after;  // lengths [s] of the partial step that ends here and of the rest of the step
  long step;
  VecX q, p_minus, p_plus;
};

// Steps and partial steps between nodes and impacts, row after row: start time and length, state at the start,
// momentum at the end (before an impact), chart rates at the stages (StepPath).
struct Segments {
  std::vector<double> t, h, q, p, p1, rates;  // rates: stage by stage
};

struct Recording {
  std::vector<double> t, q, p;  // row-major (N, nq), (N, nv)
  std::vector<ImpactRecord> impacts;
  Segments segments;
  std::vector<double> arc_t, arc_dt;  // of run_auto: start and step of each smooth arc

  // How much there is, to go back to.
  struct Mark {
    std::size_t nodes, impacts, segments;
  };
  Mark mark() const { return {t.size(), impacts.size(), segments.t.size()}; }
  void cut(const Mark& mark) {
    const std::size_t nq = t.empty() ? 0 : q.size() / t.size(), nv = t.empty() ? 0 : p.size() / t.size();
    const std::size_t count = segments.t.size(), rates = count == 0 ? 0 : segments.rates.size() / count;
    t.resize(mark.nodes);
    q.resize(mark.nodes * nq);
    p.resize(mark.nodes * nv);
    impacts.resize(mark.impacts);
    segments.t.resize(mark.segments);
    segments.h.resize(mark.segments);
    segments.q.resize(mark.segments * nq);
    segments.p.resize(mark.segments * nv);
    segments.p1.resize(mark.segments * nv);
    segments.rates.resize(mark.segments * rates);
  }
};

}  // namespace contactvi
