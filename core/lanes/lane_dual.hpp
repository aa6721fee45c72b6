// Dual numbers x + d eps, eps^2 = 0: the kernel's functions run on them give a value and its derivative along one
// direction. Included inside an unnamed namespace after lane_math.hpp's vectors of lanes.
//
// In memory the derivatives of an array lie at a fixed distance from it (LaneWork::shadow), so that the same code
// reads and writes both; plain numbers do not look there. Nested duals have a second direction, along which the numbers
// and their derivatives have derivatives of their own: those lie at two and three times that distance.

template <class V>
struct Dual {
  V x, d;
};

template <class V>
LANE_INLINE Dual<V> operator-(Dual<V> a) {
  return {-a.x, -a.d};
}
template <class A, class B>
LANE_INLINE auto operator+(Dual<A> a, Dual<B> b) -> Dual<decltype(a.x + b.x)> {
  return {a.x + b.x, a.d + b.d};
}
template <class A, class B>
LANE_INLINE auto operator-(Dual<A> a, Dual<B> b) -> Dual<decltype(a.x - b.x)> {
  return {a.x - b.x, a.d - b.d};
}
template <class A, class B>
LANE_INLINE auto operator*(Dual<A> a, Dual<B> b) -> Dual<decltype(a.x * b.x)> {
  return {a.x * b.x, a.d * b.x + a.x * b.d};
}
template <class V>
LANE_INLINE Dual<V> operator/(Dual<V> a, Dual<V> b) {
  const V quotient = a.x / b.x;
  return {quotient, (a.d - quotient * b.d) / b.x};
}
template <class V>
LANE_INLINE Dual<V> operator+(double a, Dual<V> b) {
  return {a + b.x, b.d};
}
template <class V>
LANE_INLINE Dual<V> operator+(Dual<V> a, double b) {
  return {a.x + b, a.d};
}
template <class V>
LANE_INLINE Dual<V> operator-(double a, Dual<V> b) {
  return {a - b.x, -b.d};
}
template <class V>
LANE_INLINE Dual<V> operator-(Dual<V> a, double b) {
  return {a.x - b, a.d};
}
template <class V>
LANE_INLINE Dual<V> operator*(double a, Dual<V> b) {
  return {a * b.x, a * b.d};
}
template <class V>
LANE_INLINE Dual<V> operator*(Dual<V> a, double b) {
  return {a.x * b, a.d * b};
}

template <class V>
struct Lane<Dual<V>> {
  static const int count = Lane<V>::count;
  static LANE_INLINE Dual<V> all(double x) { return {Lane<V>::all(x), Lane<V>::all(0.0)}; }
};

template <class V>
LANE_INLINE void sine_cosine(Dual<V> x, Dual<V>& sine, Dual<V>& cosine) {
  V s, c;
  sine_cosine(x.x, s, c);
  sine = {s, c * x.d};
  cosine = {c, -(s * x.d)};
}

// How lanes and single numbers stand in the arrays of LaneWork.
template <class V>
struct Memory {
  typedef double Number;
  static LANE_INLINE V get(const LaneWork&, const double* at) { return load<V>(at); }
  static LANE_INLINE void put(const LaneWork&, double* at, V x) { store<V>(at, x); }
  static LANE_INLINE double number(const LaneWork&, const double* at) { return *at; }
};
template <class V>
struct Memory<Dual<V>> {
  typedef Dual<double> Number;
  static LANE_INLINE Dual<V> get(const LaneWork& w, const double* at) { return {load<V>(at), load<V>(at + w.shadow)}; }
  static LANE_INLINE void put(const LaneWork& w, double* at, Dual<V> x) {
    store<V>(at, x.x);
    store<V>(at + w.shadow, x.d);
  }
  static LANE_INLINE Dual<double> number(const LaneWork& w, const double* at) { return {*at, at[w.shadow]}; }
};
template <class V>
struct Memory<Dual<Dual<V>>> {
  typedef Dual<Dual<double>> Number;
  typedef Memory<Dual<V>> Part;
  static LANE_INLINE Dual<Dual<V>> get(const LaneWork& w, const double* at) {
    return {Part::get(w, at), Part::get(w, at + 2 * w.shadow)};
  }
  static LANE_INLINE void put(const LaneWork& w, double* at, Dual<Dual<V>> x) {
    Part::put(w, at, x.x);
    Part::put(w, at + 2 * w.shadow, x.d);
  }
  static LANE_INLINE Number number(const LaneWork& w, const double* at) {
    return {Part::number(w, at), Part::number(w, at + 2 * w.shadow)};
  }
};
