#include "run/saved_bytes.hpp"

#include "base/refusal.hpp"
#include "run/saved_fields.hpp"

namespace contactvi {

namespace {

// What tells scenes apart whose states have other sizes.
template <class Archive>
void scene_sizes(Archive& a, const Scene& scene) {
  for (const int own : {scene.tree.nq, scene.tree.nv, scene.guard_count(), static_cast<int>(scene.geometries.size()),
                        scene.tree.elements.constraint_rows, static_cast<int>(scene.tree.followers.size())}) {
    int size = own;
    number(a, size);
    if (size != own) throw Error("one of another scene");
  }
}

}  // namespace

std::string bytes_of(const Scene& scene, const SavedWorld& saved) {
  ByteWriter writer;
  scene_sizes(writer, scene);
  value(writer, const_cast<SavedWorld&>(saved));  // a writer changes nothing
  return std::move(writer.bytes);
}

std::shared_ptr<const SavedWorld> saved_of(const Scene& scene, std::string_view bytes) try {
  ByteReader reader(bytes);
  scene_sizes(reader, scene);
  auto saved = std::make_shared<SavedWorld>();
  value(reader, *saved);
  if (reader.left() > 0) throw Error("more bytes");
  return saved;
} catch (const Error& error) {
  throw Refusal("A saved state does not belong to its scene", "one that a simulator of this scene has saved",
                error.what(), "Take what Simulator.save has returned, unpickled by the same version of contactvi");
}

}  // namespace contactvi
