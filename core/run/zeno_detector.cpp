#include "run/zeno_detector.hpp"

#include <algorithm>

namespace contactvi {

namespace {
constexpr double kZenoFlight = 0.05;        // of a step: bouncing ends where e times the last flight is below it
constexpr double kElasticFlight = 1e-2;     // of a step: as kZenoFlight, for e = 1 where forces dissipate energy
constexpr double kShortFlight = 6e-4;       // of the longest flight: upper limit of the step in these criteria,
constexpr double kShortFlightToEnd = 0.02;  // and where the run ends instead
constexpr int kZenoFlights = 4;             // flights one after the other, each shorter than the one before
constexpr int kChatterFlights = 8;          // flights one after the other below kZenoFlight of a step, shrinking or not

bool before(const Flights::Entry& entry, int guard) { return entry.first < guard; }
}  // namespace

const Bouncing* Flights::find(int guard) const {
  const auto at = std::lower_bound(entries_.begin(), entries_.end(), guard, before);
  return at != entries_.end() && at->first == guard ? &at->second : nullptr;
}

Bouncing& Flights::at(int guard) {
  auto at = std::lower_bound(entries_.begin(), entries_.end(), guard, before);
  if (at == entries_.end() || at->first != guard) at = entries_.insert(at, {guard, Bouncing()});
  return at->second;
}

ZenoDetector::ZenoDetector(const Scene& scene, bool dissipative, bool persistent)
    : dissipative_(dissipative), persistent_(persistent), plastic_(scene.guard_count(), 0) {}

// Flights shorter than this part of a step may be chatter. Elastic contacts bounce for ever unless forces dissipate
// energy.
double ZenoDetector::short_flight_limit(double e) const {
  return e < 1.0 ? kZenoFlight : dissipative_ ? kElasticFlight : 0.0;
}

void ZenoDetector::find_accumulating_impacts(const Flights& flights, ImpactSequence& sequence, const VecX& p,
                                             double time, double step) {
  for (int g : plastic_guards_) plastic_[g] = 0;
  plastic_guards_.clear();
  closing_.clear();
  for (int i = 0; i < sequence.count(); ++i) closing_.push_back(std::max(0.0, -sequence.closed(i).gamma_n(p)));
  if (!persistent_) return;
  for (int i = 0; i < sequence.count(); ++i) {
    const ClosedGuard& c = sequence.closed(i);
    const Bouncing* found = flights.find(c.guard);
    if (found == nullptr) continue;
    const Bouncing& b = *found;
    const double flight = time - b.last_time;
    if ((c.e >= 1.0 && !dissipative_) || c.e == 0.0 || b.impacts == 0 || !(flight > 0.0)) continue;
    // Short flights between impacts of one corner say nothing about that of another one, which closes faster.
    if (closing_[static_cast<std::size_t>(i)] > b.last_speed) continue;
    const bool shorter = b.impacts > 1 && flight < b.last_flight;
    const double longest = std::max(b.longest_flight, flight);
    const bool shrinking = c.e < 1.0 && shorter && b.shrinking_flights + 1 >= kZenoFlights &&
                           c.e * flight < kZenoFlight * std::min(step, kShortFlight * longest);
    const bool chatter = flight < short_flight_limit(c.e) * step && b.short_flights + 1 >= kChatterFlights;
    if (!shrinking && !chatter) continue;
    plastic_[c.guard] = 1;
    plastic_guards_.push_back(c.guard);
  }
}

double ZenoDetector::shortest_flight(const Flights& flights) const {
  double shortest = 0.0;
  for (int g : impacted_) {
    const double flight = flights.find(g)->last_flight;
    if (flight > 0.0 && (shortest == 0.0 || flight < shortest)) shortest = flight;
  }
  return shortest;
}

bool ZenoDetector::update_bouncing(Flights& flights, ImpactSequence& sequence, double time, double step,
                                   double adaptive_dt, Recording& recording) {
  impacted_.clear();
  for (int i = 0; i < sequence.count(); ++i) {
    const ClosedGuard& c = sequence.closed(i);
    if (!c.impacted) continue;
    impacted_.push_back(c.guard);
    Bouncing& b = flights.at(c.guard);
    const double flight = time - b.last_time;
    if (b.impacts > 0 && flight > 0.0) {
      const bool shorter = b.impacts > 1 && flight < b.last_flight;
      b.shrinking_flights = shorter ? b.shrinking_flights + 1 : 0;
      b.short_flights = flight < short_flight_limit(c.e) * step ? b.short_flights + 1 : 0;
      b.longest_flight = std::max(b.longest_flight, flight);
      // Flights shrink geometrically. Their measured ratio is right for articulated bodies too, while e is not.
      const double ratio = shorter ? flight / b.last_flight : c.e,
                   ends = ratio < 1.0 ? time + flight * ratio / (1.0 - ratio) : time;
      if (plastic_[c.guard] && c.count > 0)
        recording.changes.push_back({time, c.guard, c.points[0].feature, Change::kBouncingEnds, ends});
      if (!persistent_ && c.e < 1.0 && b.shrinking_flights >= kZenoFlights &&
          c.e * flight < kZenoFlight * std::min(adaptive_dt, kShortFlightToEnd * b.longest_flight)) {
        accumulating_ = c.guard;
        ends_ = ends;
        return false;
      }
      b.last_flight = flight;
    }
    b.last_time = time;
    // What the impacts themselves have closed comes behind those that were closed before.
    b.last_speed = static_cast<std::size_t>(i) < closing_.size() ? closing_[static_cast<std::size_t>(i)] : 0.0;
    ++b.impacts;
    if (plastic_[c.guard]) {  // the count starts again, unless the next flights are short at once
      const int hits = b.short_flights >= kChatterFlights ? 1 : 0;
      const double speed = b.last_speed;
      b = Bouncing();
      b.impacts = hits;
      b.last_time = time;
      b.last_speed = speed;
      b.short_flights = hits * (kChatterFlights - 1);
    }
  }
  return true;
}

}  // namespace contactvi
