// Several contact points that had one impact together, as its derivative needs them.
#pragma once

#include <vector>

#include "contact/persistent_contact.hpp"

namespace contactvi {

struct ImpactBlockRecord {
  // A contact that took part, with the points that had rows.
  struct Member {
    int guard;
    double e;
    std::vector<ContactPoint> points;
  };
  std::vector<Member> members;
  int impacts;  // records of it, one after the other: of the members that had an impulse
  // Of the first one of these records, by which they are found again.
  double time, impulse;
  int guard;
};

}  // namespace contactvi
