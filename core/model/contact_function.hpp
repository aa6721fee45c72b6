// A number that a law of the user gives for one to three numbers of a contact, of many contacts at once: a function of
// arrays, or a compiled one that is called for each contact.
#pragma once

#include <functional>
#include <utility>

namespace contactvi {

// A value and its derivatives by the numbers.
struct ContactValue {
  double value = 0.0, by_first = 0.0, by_second = 0.0, by_third = 0.0;
};

class ContactFunction {
 public:
  // Sets the values at rows of numbers, of two or three as the law has; the derivatives where they are wanted.
  using Rows = std::function<void(const double* numbers, int count, bool derivatives, ContactValue* values)>;
  explicit ContactFunction(Rows rows) : rows_(std::move(rows)) {}

  void operator()(const double* numbers, int count, bool derivatives, ContactValue* values) const {
    rows_(numbers, count, derivatives, values);
  }
  ContactValue operator()(double first, double second, bool derivatives = false) const {
    const double numbers[2] = {first, second};
    ContactValue value;
    rows_(numbers, 1, derivatives, &value);
    return value;
  }
  ContactValue operator()(double first, double second, double third, bool derivatives) const {
    const double numbers[3] = {first, second, third};
    ContactValue value;
    rows_(numbers, 1, derivatives, &value);
    return value;
  }

 private:
  Rows rows_;
};

}  // namespace contactvi
