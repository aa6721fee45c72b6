// Values as bytes, for writing and for reading: numbers, matrices, lists, pairs, texts, shared constants, and structs
// for which a function fields(archive, struct) calls values() on all fields. A reader throws an Error that tells what
// the bytes are instead.
//
// A writer changes nothing; it takes what it writes by reference because a reader does.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "base/error.hpp"

namespace contactvi {

class ByteWriter {
 public:
  static constexpr bool kReads = false;
  void raw(void* from, std::size_t size) { bytes.append(static_cast<const char*>(from), size); }
  std::string bytes;
};

class ByteReader {
 public:
  static constexpr bool kReads = true;
  explicit ByteReader(std::string_view bytes) : rest_(bytes) {}
  std::size_t left() const { return rest_.size(); }
  void raw(void* to, std::size_t size) {
    if (size > rest_.size()) throw Error("fewer bytes");
    if (size > 0) std::memcpy(to, rest_.data(), size);
    rest_.remove_prefix(size);
  }

 private:
  std::string_view rest_;
};

template <class T>
struct IsVector : std::false_type {};
template <class T>
struct IsVector<std::vector<T>> : std::true_type {};
template <class T>
struct IsPair : std::false_type {};
template <class A, class B>
struct IsPair<std::pair<A, B>> : std::true_type {};
template <class T>
struct IsShared : std::false_type {};
template <class T>
struct IsShared<std::shared_ptr<const T>> : std::true_type {};

template <class Archive, class T>
void number(Archive& a, T& x) {
  if constexpr (std::is_same_v<T, bool>) {
    unsigned char byte = Archive::kReads ? 0 : x;
    a.raw(&byte, 1);
    if (byte > 1) throw Error("a byte that is neither yes nor no");
    x = byte == 1;
  } else {
    a.raw(&x, sizeof(T));
  }
}

// The size of a list whose entries take at least a byte each.
template <class Archive>
std::size_t size_of_list(Archive& a, std::size_t size) {
  std::uint64_t count = size;
  number(a, count);
  if constexpr (Archive::kReads)
    if (count > a.left()) throw Error("a list with fewer entries");
  return static_cast<std::size_t>(count);
}

template <class Archive, class T>
void value(Archive& a, T& x);

template <class Archive, class Matrix>
void matrix(Archive& a, Matrix& x) {
  std::int64_t rows = x.rows(), columns = x.cols();
  number(a, rows);
  number(a, columns);
  if constexpr (Archive::kReads) {
    const auto most = static_cast<std::int64_t>(a.left() / sizeof(double));
    if (rows < 0 || columns < 0 || (columns > 0 && rows > most / columns)) throw Error("a matrix with fewer numbers");
    if constexpr (Matrix::SizeAtCompileTime != Eigen::Dynamic) {
      if (rows != x.rows() || columns != x.cols()) throw Error("a matrix of another size");
    } else {
      if (Matrix::ColsAtCompileTime == 1 && columns != 1) throw Error("a matrix of another size");
      x.resize(rows, columns);
    }
  }
  a.raw(x.data(), static_cast<std::size_t>(x.size()) * sizeof(double));
}

template <class Archive, class T>
void list(Archive& a, std::vector<T>& x) {
  const std::size_t size = size_of_list(a, x.size());
  if constexpr (std::is_arithmetic_v<T>) {
    if constexpr (Archive::kReads) {
      if (size > a.left() / sizeof(T)) throw Error("a list with fewer entries");
      x.resize(size);
    }
    a.raw(x.data(), size * sizeof(T));
  } else {
    if constexpr (Archive::kReads) x.resize(size);
    for (T& entry : x) value(a, entry);
  }
}

template <class Archive, class T>
void shared(Archive& a, std::shared_ptr<const T>& x) {
  bool given = x != nullptr;
  number(a, given);
  if (!given) return;
  if constexpr (Archive::kReads) {
    auto read = std::make_shared<T>();
    value(a, *read);
    x = std::move(read);
  } else {
    value(a, const_cast<T&>(*x));  // a writer changes nothing
  }
}

// Of all fields of a struct.
template <class Archive, class... Ts>
void values(Archive& a, Ts&... xs) {
  (value(a, xs), ...);
}

template <class Archive, class T>
void value(Archive& a, T& x) {
  if constexpr (std::is_arithmetic_v<T> || std::is_enum_v<T>) {
    number(a, x);
  } else if constexpr (std::is_base_of_v<Eigen::MatrixBase<T>, T>) {
    matrix(a, x);
  } else if constexpr (std::is_same_v<T, std::string>) {
    std::vector<char> text(x.begin(), x.end());
    list(a, text);
    if constexpr (Archive::kReads) x.assign(text.begin(), text.end());
  } else if constexpr (IsVector<T>::value) {
    list(a, x);
  } else if constexpr (IsPair<T>::value) {
    values(a, x.first, x.second);
  } else if constexpr (IsShared<T>::value) {
    shared(a, x);
  } else {
    fields(a, x);
  }
}

}  // namespace contactvi
