// Where the features at which persistent contacts touch change: a ball that rolls off the edge of a box, from the side
// of a capsule to its tip, from one facet of a hull to the next; a corner that slides over the border of a face.
//
// The gap of a pair goes on smoothly there, but not its second derivative (geometry/nearest_region.hpp). A smooth step
// is true to its order only if it ends there.
#pragma once

#include "contact/persistent_contact.hpp"
#include "geometry/guard.hpp"
#include "geometry/nearest_region.hpp"

namespace contactvi {

class FeatureBorders {
 public:
  explicit FeatureBorders(Guards& guards) : guards_(&guards) {}

  // A step starts where the guards are placed. The contacts are to stay alive until the next one.
  void begin(const std::vector<PersistentContact>& contacts);
  // The guards are placed a little later in it: a nearest point that began on a border is in the region that it has
  // come to.
  void settle();
  // Features with borders, of all contacts.
  int count() const { return static_cast<int>(features_.size()); }
  std::size_t contact(int k) const { return features_[static_cast<std::size_t>(k)].contact; }
  // Whether the point of the contact ends with its feature, and another one takes its place.
  bool ends_point(int k) const { return !features_[static_cast<std::size_t>(k)].region.any(); }
  // How far the point of one of them is from the border of its feature where the guards are placed, and at the start of
  // the step, over the size of the shape; negative beyond it.
  double depth(int k);
  double start_depth(int k) const;

 private:
  // One shape of a pair, and the point that its regions are of; or a point over a face, without a region.
  struct Feature {
    std::size_t contact;
    bool of_b;
    double size;  // [m]
    NearestRegion region;
    Vec3 start;          // the point at the start of the step, in the shape's frame
    double start_depth;  // without a region [m]
  };
  int guard(const Feature& feature) const { return (*contacts_)[feature.contact].point.guard; }
  const Geometry& geometry(const Feature& feature, bool of_b) const;
  // Of the shape, and of the other one.
  const ShapeFeatures& shape(const Feature& feature) const;
  const ShapeFeatures& others(const Feature& feature) const;
  Vec3 nearest(const Feature& feature);
  double inside_face(const Feature& feature) const;

  Guards* guards_;
  const std::vector<PersistentContact>* contacts_ = nullptr;
  std::vector<Feature> features_;
};

}  // namespace contactvi
