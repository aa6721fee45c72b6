// Values that are made when they are first asked for.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>

namespace contactvi {

// A constant that the first call of get() makes, in whichever thread it comes; others wait for it. What `make` returns
// may depend on nothing but what it has captured, so that it does not matter who asks first.
template <class T>
class OnDemand {
 public:
  explicit OnDemand(std::function<T()> make) : make_(std::move(make)) {}

  // Throws what `make` throws.
  const T& get() const {
    const T* made = made_.load(std::memory_order_acquire);
    return made != nullptr ? *made : make();
  }

 private:
  const T& make() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!value_) {
      value_ = std::make_unique<const T>(make_());
      make_ = nullptr;  // and what it has captured
      made_.store(value_.get(), std::memory_order_release);
    }
    return *value_;
  }

  mutable std::function<T()> make_;
  mutable std::unique_ptr<const T> value_;
  mutable std::atomic<const T*> made_{nullptr};
  mutable std::mutex mutex_;
};

}  // namespace contactvi
