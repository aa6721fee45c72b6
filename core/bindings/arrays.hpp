// Numbers handed to numpy without a copy, and the types that signatures name in the stub.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <utility>
#include <vector>

#include "base/numerics.hpp"

namespace contactvi {

using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using IntVec = Eigen::Matrix<std::int64_t, Eigen::Dynamic, 1>;

using Array1 = nanobind::ndarray<nanobind::numpy, double, nanobind::ndim<1>>;
using Array2 = nanobind::ndarray<nanobind::numpy, double, nanobind::ndim<2>>;
// Named results of a call. contactvi/simulation/results.py gives the types of their entries.
using Dict = nanobind::typed<nanobind::dict, nanobind::str, nanobind::any>;

// Takes the storage over, so that numpy sees its numbers, of the given shape, as long as the array lives.
template <class Array, class Storage>
Array hand_over_as(Storage&& storage, std::initializer_list<std::size_t> shape) {
  auto* kept = new std::decay_t<Storage>(std::forward<Storage>(storage));
  nanobind::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::decay_t<Storage>*>(p); });
  return Array(kept->data(), shape, owner);
}

inline Array1 hand_over(std::vector<double>&& values) {
  const std::size_t n = values.size();
  return hand_over_as<Array1>(std::move(values), {n});
}
inline Array2 hand_over(std::vector<double>&& values, std::size_t rows, std::size_t columns) {
  return hand_over_as<Array2>(std::move(values), {rows, columns});
}
inline Array1 hand_over(VecX&& values) {
  const std::size_t n = static_cast<std::size_t>(values.size());
  return hand_over_as<Array1>(std::move(values), {n});
}
inline Array2 hand_over(Rows&& values) {
  const std::size_t n = static_cast<std::size_t>(values.rows()), m = static_cast<std::size_t>(values.cols());
  return hand_over_as<Array2>(std::move(values), {n, m});
}

}  // namespace contactvi
