#pragma once

#include <cstddef>
#include <memory>

namespace contactvi {

// Doubles in memory that is aligned for vector registers of any width (64 bytes), zero at first.
class AlignedArray {
 public:
  explicit AlignedArray(std::size_t size);
  AlignedArray(const AlignedArray& other);
  AlignedArray& operator=(const AlignedArray& other);
  AlignedArray(AlignedArray&&) = default;
  AlignedArray& operator=(AlignedArray&&) = default;
  ~AlignedArray() = default;
  double* data() { return data_; }
  const double* data() const { return data_; }
  double& operator[](std::size_t i) { return data_[i]; }
  double operator[](std::size_t i) const { return data_[i]; }
  void fill(double value);
  std::size_t size() const { return size_; }

 private:
  struct Free {
    void operator()(double* p) const;
  };
  std::unique_ptr<double[], Free> owner_;
  double* data_;
  std::size_t size_;
};

}  // namespace contactvi
