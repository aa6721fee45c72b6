// Vectors of lanes and the elementary functions on them. Included inside an unnamed namespace, V = double or a vector
// of doubles; the same operations in the same order for each, so the bits agree.

// A call of one of these small functions would cost more than its work.
#define LANE_INLINE inline __attribute__((always_inline))

#ifdef __AVX2__
typedef double V4 __attribute__((vector_size(32)));
typedef long long I4 __attribute__((vector_size(32)));
#endif
#ifdef __AVX512F__
typedef double V8 __attribute__((vector_size(64)));
typedef long long I8 __attribute__((vector_size(64)));
#endif

template <class V>
struct Lane;
template <>
struct Lane<double> {
  typedef long long Int;
  static const int count = 1;
  static LANE_INLINE long long bits(double x) {
    long long i;
    __builtin_memcpy(&i, &x, sizeof(i));
    return i;
  }
  static LANE_INLINE double value(long long i) {
    double x;
    __builtin_memcpy(&x, &i, sizeof(x));
    return x;
  }
  static LANE_INLINE double all(double x) { return x; }
};
#ifdef __AVX2__
template <>
struct Lane<V4> {
  typedef I4 Int;
  static const int count = 4;
  static LANE_INLINE I4 bits(V4 x) { return (I4)x; }
  static LANE_INLINE V4 value(I4 i) { return (V4)i; }
  static LANE_INLINE V4 all(double x) { return V4{x, x, x, x}; }
};
#endif
#ifdef __AVX512F__
template <>
struct Lane<V8> {
  typedef I8 Int;
  static const int count = 8;
  static LANE_INLINE I8 bits(V8 x) { return (I8)x; }
  static LANE_INLINE V8 value(I8 i) { return (V8)i; }
  static LANE_INLINE V8 all(double x) { return V8{x, x, x, x, x, x, x, x}; }
};
#endif

// Vectors may be read and written where doubles stand, as those of the compilers' own headers are. Unlike a copy of
// bytes such an access cannot be one to the pointers of LaneWork: they stay in registers.
template <class V>
LANE_INLINE V load(const double* at) {
  return *reinterpret_cast<const V*>(at);
}
template <class V>
LANE_INLINE void store(double* at, V x) {
  *reinterpret_cast<V*>(at) = x;
}
template <class V>
LANE_INLINE V absolute(V x) {
  return Lane<V>::value(Lane<V>::bits(x) & 0x7fffffffffffffffLL);
}

// sin and cos for |x| up to 1e6: Cody-Waite reduction with three 33-bit parts of pi/2 (their products with the
// quadrant are exact) and the minimax polynomials of fdlibm's __kernel_sin and __kernel_cos. 1.4 ulp.
template <class V>
LANE_INLINE void sine_cosine(V x, V& sine, V& cosine) {
  typedef typename Lane<V>::Int I;
  const double shift = 6755399441055744.0;  // 1.5 * 2^52: the last bits of a sum with it are the rounded number
  const V shifted = x * 0.63661977236758134308 + shift;
  const V n = shifted - shift;
  const V r = ((x - n * 1.57079632673412561417e+00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
  const I quadrant = Lane<V>::bits(shifted);
  const V z = r * r;
  const V s = r + r * z *
                      (-1.66666666666666324348e-01 +
                       z * (8.33333333332248946124e-03 +
                            z * (-1.98412698298579493134e-04 +
                                 z * (2.75573137070700676789e-06 +
                                      z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  const V tail = z * z *
                 (4.16666666666666019037e-02 +
                  z * (-1.38888888888741095749e-03 +
                       z * (2.48015872894767294178e-05 +
                            z * (-2.75573143513906633035e-07 +
                                 z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
  const V half = 0.5 * z, one = 1.0 - half;
  const V c = one + (((1.0 - one) - half) + tail);
  const I odd = -(quadrant & 1);
  const I sin_bits = (Lane<V>::bits(c) & odd) | (Lane<V>::bits(s) & ~odd);
  const I cos_bits = (Lane<V>::bits(s) & odd) | (Lane<V>::bits(c) & ~odd);
  sine = Lane<V>::value(sin_bits ^ ((quadrant & 2) << 62));
  cosine = Lane<V>::value(cos_bits ^ (((quadrant + 1) & 2) << 62));
}

#include "lane_dual.hpp"

template <class V>
struct V3 {
  V x, y, z;
};
template <class V>
LANE_INLINE V3<V> operator+(V3<V> a, V3<V> b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class V>
LANE_INLINE V3<V> operator-(V3<V> a, V3<V> b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class V, class S>
LANE_INLINE V3<V> times(S k, V3<V> a) {
  return {k * a.x, k * a.y, k * a.z};
}
template <class V>
LANE_INLINE V dot(V3<V> a, V3<V> b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class V>
LANE_INLINE V3<V> cross(V3<V> a, V3<V> b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
// r x a and a x r for a constant r.
template <class V>
LANE_INLINE V3<V> cross(const double* r, V3<V> a) {
  return {r[1] * a.z - r[2] * a.y, r[2] * a.x - r[0] * a.z, r[0] * a.y - r[1] * a.x};
}

const double kInverseFactorial[36] = {// 1/n!
                                      1.0,
                                      1.0,
                                      0.5,
                                      0.16666666666666666,
                                      0.041666666666666664,
                                      0.008333333333333333,
                                      0.001388888888888889,
                                      0.0001984126984126984,
                                      2.48015873015873e-05,
                                      2.7557319223985893e-06,
                                      2.755731922398589e-07,
                                      2.505210838544172e-08,
                                      2.08767569878681e-09,
                                      1.6059043836821613e-10,
                                      1.1470745597729725e-11,
                                      7.647163731819816e-13,
                                      4.779477332387385e-14,
                                      2.8114572543455206e-15,
                                      1.5619206968586225e-16,
                                      8.22063524662433e-18,
                                      4.110317623312165e-19,
                                      1.9572941063391263e-20,
                                      8.896791392450574e-22,
                                      3.868170170630684e-23,
                                      1.6117375710961184e-24,
                                      6.446950284384474e-26,
                                      2.4795962632247976e-27,
                                      9.183689863795546e-29,
                                      3.279889237069838e-30,
                                      1.1309962886447716e-31,
                                      3.7699876288159054e-33,
                                      1.216125041553518e-34,
                                      3.8003907548547434e-36,
                                      1.151633562077195e-37,
                                      3.387157535521162e-39,
                                      9.67759295863189e-41};

// Coefficients of exp and of the right Jacobian of SO(3) at X as power series in t = |X|^2, good to |X| = 4 without
// any case distinction (lanes mix small and large rotations):
//   b = (theta - sin theta)/theta^3, d = (1/2 - (1 - cos theta)/theta^2)/theta^2, and their derivatives in t;
//   a = 1/2 - t d = (1 - cos theta)/theta^2, sinc = 1 - t b, c of J^-1 = (b - 2 d)/(2 a).
template <class V>
struct Rotation {
  V3<V> X;
  V t, a, b, c, sinc, a1, b1;  // a1, b1: da/dt, db/dt
};

template <class V>
LANE_INLINE Rotation<V> rotation(V3<V> X) {
  const int terms = 16;
  const double* f = kInverseFactorial;
  Rotation<V> k;
  k.X = X;
  k.t = dot(X, X);
  V b = Lane<V>::all(-f[2 * terms + 1]), d = Lane<V>::all(-f[2 * terms + 2]);
  V b1 = Lane<V>::all(0.0), d1 = b1;
  for (int i = terms - 2; i >= 0; --i) {
    const double sign = i % 2 == 0 ? 1.0 : -1.0;
    b1 = b + k.t * b1;
    d1 = d + k.t * d1;
    b = sign * f[2 * i + 3] + k.t * b;
    d = sign * f[2 * i + 4] + k.t * d;
  }
  k.a = 0.5 - k.t * d;
  k.b = b;
  k.c = (b - 2.0 * d) / (2.0 * k.a);
  k.sinc = 1.0 - k.t * b;
  k.a1 = -(d + k.t * d1);
  k.b1 = b1;
  return k;
}

// y + a X x y + b X x (X x y)
template <class V>
LANE_INLINE V3<V> apply(V3<V> X, V a, V b, V3<V> y) {
  const V3<V> once = cross(X, y);
  return y + times(a, once) + times(b, cross(X, once));
}
template <class V>
LANE_INLINE V3<V> exp_apply(const Rotation<V>& k, V3<V> y) {
  return apply(k.X, k.sinc, k.a, y);
}
template <class V>
LANE_INLINE V3<V> jacobian_transpose(const Rotation<V>& k, V3<V> y) {  // J^T y
  return apply(k.X, k.a, k.b, y);
}
template <class V>
LANE_INLINE V3<V> jacobian_inverse(const Rotation<V>& k, V3<V> y) {  // J^-1 y
  return apply(k.X, Lane<V>::all(0.5), k.c, y);
}
template <class V>
LANE_INLINE V3<V> jacobian_inverse_transpose(const Rotation<V>& k, V3<V> y) {
  return apply(k.X, Lane<V>::all(-0.5), k.c, y);
}
// (dJ/dt along X')^T p
template <class V>
LANE_INLINE V3<V> jacobian_rate_transpose(const Rotation<V>& k, V3<V> rate, V3<V> p) {
  const V turn = 2.0 * dot(k.X, rate);
  const V3<V> once = cross(k.X, p), moved = cross(rate, p);
  V3<V> sum = times(k.a1 * turn, once) + times(k.a, moved);
  sum = sum + times(k.b1 * turn, cross(k.X, once));
  return sum + times(k.b, cross(rate, once) + cross(k.X, moved));
}
