#include "geometry/prepare.hpp"

#include "geometry/pair_table.hpp"
#include "geometry/shape_features.hpp"

namespace contactvi {

void prepare_geometry(Scene& scene) {
  add_shape_features(scene);
  scene.pair_table = std::make_shared<const PairTable>(scene.pairs, scene.geometries.size());
}

}  // namespace contactvi
