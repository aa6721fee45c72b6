// Numbers handed to numpy without a copy.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <utility>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Takes the storage over; data: its numbers, of the given shape.
template <class Storage>
nanobind::object hand_over(Storage&& storage, std::initializer_list<std::size_t> shape) {
  auto* kept = new std::decay_t<Storage>(std::forward<Storage>(storage));
  nanobind::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::decay_t<Storage>*>(p); });
  return nanobind::cast(nanobind::ndarray<nanobind::numpy, double>(kept->data(), shape, owner));
}

inline nanobind::object hand_over(std::vector<double>&& values) {
  const std::size_t n = values.size();
  return hand_over(std::move(values), {n});
}
inline nanobind::object hand_over(std::vector<double>&& values, std::size_t rows, std::size_t columns) {
  return hand_over(std::move(values), {rows, columns});
}
inline nanobind::object hand_over(VecX&& values) {
  const std::size_t n = static_cast<std::size_t>(values.size());
  return hand_over(std::move(values), {n});
}
inline nanobind::object hand_over(Rows&& values) {
  const std::size_t n = static_cast<std::size_t>(values.rows()), m = static_cast<std::size_t>(values.cols());
  return hand_over(std::move(values), {n, m});
}

}  // namespace contactvi
