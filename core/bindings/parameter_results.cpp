#include "bindings/parameter_results.hpp"

#include <nanobind/eigen/dense.h>

#include <utility>

#include "base/error.hpp"

namespace nb = nanobind;

namespace contactvi {

Parameters parameters_of(const Tree& tree, const StepParameters& sums) {
  const std::size_t joints = tree.body_of_source.size();
  Rows inertia = Rows::Zero(static_cast<Eigen::Index>(joints), 10);
  VecX stiffness = VecX::Zero(static_cast<Eigen::Index>(joints));
  for (std::size_t i = 0; i < joints; ++i) {
    const int body = tree.body_of_source[i];
    if (body < 0) continue;
    const auto own = sums.inertia.row(body);
    const Mat3 back = tree.R_body_source[i].transpose();
    // Off-diagonal numbers stand for two places of the matrix each.
    Mat3 slope;
    slope << own[4], 0.5 * own[5], 0.5 * own[6], 0.5 * own[5], own[7], 0.5 * own[8], 0.5 * own[6], 0.5 * own[8], own[9];
    slope = back * slope * back.transpose();
    const Vec3 moment = back * Vec3(own[1], own[2], own[3]);
    inertia.row(i) << own[0], moment.transpose(), slope(0, 0), 2.0 * slope(0, 1), 2.0 * slope(0, 2), slope(1, 1),
        2.0 * slope(1, 2), slope(2, 2);
    stiffness[i] = sums.stiffness[body];
  }
  Parameters d;
  d["inertia"] = inertia;
  d["stiffness"] = stiffness;
  d["armature"] = sums.armature;
  d["damping"] = sums.damping;
  d["rest"] = sums.rest;
  d["kp"] = sums.kp;
  d["kd"] = sums.kd;
  d["q_ref"] = sums.q_ref;
  d["v_ref"] = sums.v_ref;
  d["feed"] = sums.feed;
  d["gravity"] = VecX(sums.gravity);
  return d;
}

StepParameters parameter_direction(const Tree& tree, const nb::dict& given) {
  StepParameters d(tree);
  const std::size_t joints = tree.body_of_source.size();
  if (given.contains("inertia")) {
    const Rows numbers = nb::cast<Rows>(given["inertia"]);
    if (numbers.rows() != static_cast<Eigen::Index>(joints) || numbers.cols() != 10)
      throw Error("inertia: expected shape (njoints, 10)");
    for (std::size_t i = 0; i < joints; ++i) {
      const int body = tree.body_of_source[i];
      if (body < 0) continue;
      const auto own = numbers.row(static_cast<Eigen::Index>(i));
      const Mat3& R = tree.R_body_source[i];
      Mat3 I;
      I << own[4], own[5], own[6], own[5], own[7], own[8], own[6], own[8], own[9];
      I = R * I * R.transpose();
      const Vec3 moment = R * Vec3(own[1], own[2], own[3]);
      d.inertia.row(body) << own[0], moment.transpose(), I(0, 0), I(0, 1), I(0, 2), I(1, 1), I(1, 2), I(2, 2);
    }
  }
  if (given.contains("stiffness")) {
    const VecX numbers = nb::cast<VecX>(given["stiffness"]);
    if (numbers.size() != static_cast<Eigen::Index>(joints)) throw Error("stiffness: expected shape (njoints,)");
    for (std::size_t i = 0; i < joints; ++i)
      if (tree.body_of_source[i] >= 0) d.stiffness[tree.body_of_source[i]] = numbers[static_cast<Eigen::Index>(i)];
  }
  if (given.contains("gravity")) d.gravity = nb::cast<VecX>(given["gravity"]);
  for (auto [name, entry] : {std::pair("armature", &d.armature), std::pair("damping", &d.damping),
                             std::pair("rest", &d.rest), std::pair("kp", &d.kp), std::pair("kd", &d.kd)}) {
    if (!given.contains(name)) continue;
    *entry = nb::cast<VecX>(given[name]);
    if (entry->size() != tree.nv) throw Error("a parameter of the joints: expected shape (nv,)");
  }
  return d;
}

}  // namespace contactvi
