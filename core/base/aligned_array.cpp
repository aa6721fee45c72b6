#include "base/aligned_array.hpp"

#include <algorithm>
#include <cstdlib>
#include <new>

namespace contactvi {

void AlignedArray::Free::operator()(double* p) const { std::free(p); }

AlignedArray::AlignedArray(std::size_t size) : size_(size) {
  const std::size_t bytes = std::max<std::size_t>(1, (size * sizeof(double) + 63) / 64) * 64;
  owner_.reset(static_cast<double*>(std::aligned_alloc(64, bytes)));
  if (!owner_) throw std::bad_alloc();
  data_ = owner_.get();
  fill(0.0);
}

AlignedArray::AlignedArray(const AlignedArray& other) : AlignedArray(other.size_) {
  std::copy_n(other.data_, size_, data_);
}

AlignedArray& AlignedArray::operator=(const AlignedArray& other) {
  if (this != &other) *this = AlignedArray(other);
  return *this;
}

void AlignedArray::fill(double value) { std::fill(data_, data_ + size_, value); }

}  // namespace contactvi
