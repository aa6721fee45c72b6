#include "impact/impact_maps.hpp"

#include "base/error.hpp"
#include "impact/ctec.hpp"
#include "impact/dtec.hpp"
#include "impact/mhc.hpp"

namespace contactvi {

const ImpactLaw& impact_law(ImpactMap map) {
  switch (map) {
    case ImpactMap::kCtec:
      return ctec_law();
    case ImpactMap::kDtec:
      return dtec_law();
    case ImpactMap::kMhc:
      return mhc_law();
  }
  throw Error("unknown impact map");
}

}  // namespace contactvi
