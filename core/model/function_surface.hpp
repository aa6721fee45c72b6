// Surfaces that a function of the user gives: a height over a plane, or a signed distance.
#pragma once

#include <functional>
#include <utility>
#include <vector>

#include "model/tree.hpp"

namespace contactvi {

// Where a surface is nearest to a point: how far that is [m], negative below the surface, and the surface's normal
// there, unit, outward.
struct SurfaceFoot {
  double distance;
  Vec3 normal;

  // Where it is, of the point whose foot it is.
  Vec3 of(const Vec3& point) const { return point - distance * normal; }
};

// A surface is constant, and asked by several threads at once.
class FunctionSurface {
 public:
  // Told of a point of which no foot is known although it is a place where bodies may be.
  using Lost = std::function<void(const Vec3&)>;

  explicit FunctionSurface(Lost lost) : lost_(std::move(lost)) {}
  FunctionSurface(const FunctionSurface&) = delete;
  FunctionSurface& operator=(const FunctionSurface&) = delete;
  virtual ~FunctionSurface() = default;

  // The feet of points in the frame of the surface, about which there are balls of this radius [m]. A distance that is
  // not a number: the function failed there, no foot was found, or a ball touches in two feet.
  void nearest(const Vec3* points, int count, double ball, SurfaceFoot* feet) const;

  // At the foot of a point: how the outward normal changes along the surface, dn = B dx (Weingarten's map), symmetric
  // and zero along the normal [1/m]. Positive where the solid bulges. Not finite where it is not known. Of several feet
  // the one near `place`.
  virtual Mat3 bend(const Vec3& point, const Vec3& place) const = 0;

  // Whether all feet of a ball are known: it may then touch in several of them, each of which moves on its own.
  virtual bool knows_all_feet() const { return false; }
  // Of such a surface: the nearest foot of a point, and of one outside those on its side that are nearer than `reach`
  // [m].
  virtual void all_feet(const Vec3& point, double reach, std::vector<SurfaceFoot>& feet) const;
  // Of such a surface: the foot to which the distance falls from a place near the surface.
  virtual SurfaceFoot foot_near(const Vec3& point, const Vec3& place) const;

  // Of the distance of a point, how much may be relied on for points that are far: a foot is searched for in the
  // neighbourhood that the distance spans, not everywhere.
  virtual double reliable_share() const = 0;

  // Tells that there is no gap at a point, where bodies may be.
  void lose(const Vec3& point) const { lost_(point); }

 private:
  virtual void find(const Vec3* points, int count, double ball, SurfaceFoot* feet) const = 0;

  Lost lost_;
};

// z = f(x, y), solid below. The function is given points as rows x, y and fills rows f, f_x, f_y, f_xx, f_xy, f_yy.
//
// The foot of a point is where the squared distance |(u, f(u)) - x|^2 / 2 is least: Newton's method on it, damped
// where its Hessian is not positive or a step does not descend (Nocedal, Wright, "Numerical optimization", 2006,
// section 3.4), from the place below the point and from eight around it at half of the height. The gap is of second
// order in the error of the foot, so that a Hessian by differences costs steps and no digits.
class HeightSurface final : public FunctionSurface {
 public:
  using Function = std::function<void(const double* xy, int count, double* values)>;
  static constexpr int kValues = 6;

  HeightSurface(Function function, Lost lost) : FunctionSurface(std::move(lost)), function_(std::move(function)) {}
  Mat3 bend(const Vec3& point, const Vec3& place) const override;
  double reliable_share() const override { return 0.5; }

 private:
  void find(const Vec3* points, int count, double ball, SurfaceFoot* feet) const override;

  Function function_;
};

// d(x, y, z), a true distance: |grad d| = 1. The function is given points as rows x, y, z and fills rows d, d_x, d_y,
// d_z. Where the gradient is no unit vector the distance is not a number.
class DistanceSurface final : public FunctionSurface {
 public:
  using Function = std::function<void(const double* xyz, int count, double* values)>;
  static constexpr int kValues = 4;
  // By how much the length of a gradient may differ from one: that of differences, not more.
  static constexpr double kUnit = 1e-6;

  DistanceSurface(Function function, Lost lost) : FunctionSurface(std::move(lost)), function_(std::move(function)) {}
  // By differences of the gradient.
  Mat3 bend(const Vec3& point, const Vec3& place) const override;
  double reliable_share() const override { return 1.0; }

 private:
  void find(const Vec3* points, int count, double ball, SurfaceFoot* feet) const override;

  Function function_;
};

}  // namespace contactvi
