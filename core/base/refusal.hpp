// What the engine refuses of what the user gave it.
#pragma once

#include <string>
#include <utility>

#include "base/error.hpp"

namespace contactvi {

// The texts are those of contactvi.errors.ContactviError: the fact, what was expected, what was got, what to do.
class Refusal : public Error {
 public:
  Refusal(const std::string& fact, std::string expected_text, std::string got_text, std::string remedy_text)
      : Error(fact), expected(std::move(expected_text)), got(std::move(got_text)), remedy(std::move(remedy_text)) {}
  const std::string expected, got, remedy;
};

}  // namespace contactvi
