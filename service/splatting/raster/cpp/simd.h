// Thin vectors for the kernels. Each kernel file is compiled once per instruction set (see CMakeLists.txt), which
// defines FS_AVX512, FS_AVX2 or neither; everything here lives in a namespace of that name, so that no inline function
// compiled for one machine can be linked into the code for another.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#if defined(FS_AVX512) || defined(FS_AVX2) || defined(__SSE2__)
#include <immintrin.h>
#endif

#if defined(FS_AVX512)
#define FS_NS avx512
#elif defined(FS_AVX2)
#define FS_NS avx2
#else
#define FS_NS baseline
#endif
#define FS_INLINE static inline __attribute__((always_inline))

namespace FS_NS {

#if defined(FS_AVX512)
constexpr int W = 16;       // float lanes
constexpr int BLOCK_H = 4;  // a block is 4 pixels wide and BLOCK_H high: one vector
constexpr int TILE_W = 32;  // pixels: wide tiles make few pairs; 64 blocks are what a mask can name
using vf = __m512;
using vi = __m512i;
using vm = __mmask16;
FS_INLINE vf set1(float x) { return _mm512_set1_ps(x); }
FS_INLINE vf zero() { return _mm512_setzero_ps(); }
FS_INLINE vf load(const float* p) { return _mm512_load_ps(p); }
FS_INLINE vf loadu(const float* p) { return _mm512_loadu_ps(p); }
FS_INLINE void store(float* p, vf a) { _mm512_store_ps(p, a); }
FS_INLINE void storeu(float* p, vf a) { _mm512_storeu_ps(p, a); }
FS_INLINE vi loadi(const int32_t* p) { return _mm512_load_si512(p); }
FS_INLINE void storei(int32_t* p, vi a) { _mm512_store_si512(p, a); }
FS_INLINE vi set1i(int32_t x) { return _mm512_set1_epi32(x); }
FS_INLINE vf fma(vf a, vf b, vf c) { return _mm512_fmadd_ps(a, b, c); }
FS_INLINE vf fnma(vf a, vf b, vf c) { return _mm512_fnmadd_ps(a, b, c); }
FS_INLINE vf vmin(vf a, vf b) { return _mm512_min_ps(a, b); }
FS_INLINE vf vmax(vf a, vf b) { return _mm512_max_ps(a, b); }
FS_INLINE vf vsqrt(vf a) { return _mm512_sqrt_ps(a); }
FS_INLINE vf vabs(vf a) { return _mm512_abs_ps(a); }
FS_INLINE vm ge(vf a, vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_GE_OQ); }
FS_INLINE vm gt(vf a, vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ); }
FS_INLINE vm le(vf a, vf b) { return _mm512_cmp_ps_mask(a, b, _CMP_LE_OQ); }
FS_INLINE vm gti(vi a, vi b) { return _mm512_cmpgt_epi32_mask(a, b); }
FS_INLINE vm eqi(vi a, vi b) { return _mm512_cmpeq_epi32_mask(a, b); }
FS_INLINE vm both(vm a, vm b) { return (vm)(a & b); }
FS_INLINE vm but(vm a, vm b) { return (vm)(a & ~b); }
FS_INLINE bool any(vm a) { return a != 0; }
FS_INLINE bool all(vm a) { return a == 0xffff; }
FS_INLINE vf keep(vm m, vf a) { return _mm512_maskz_mov_ps(m, a); }
FS_INLINE vf select(vm m, vf a, vf b) { return _mm512_mask_blend_ps(m, b, a); }
FS_INLINE vi selecti(vm m, vi a, vi b) { return _mm512_mask_blend_epi32(m, b, a); }
// 2^f on [-0.5, 0.5]: minimax polynomial of degree 5, error 9e-8, its terms in pairs because latency is what takes
// time.
FS_INLINE vf exp2_fraction(vf f) {
  const vf f2 = f * f;
  const vf low = fma(set1(6.931469776e-1f), f, set1(1.0f)),
           middle = fma(set1(5.550733778e-2f), f, set1(2.402224208e-1f));
  const vf high = fma(set1(1.326472037e-3f), f, set1(9.671513022e-3f));
  return fma(fma(high, f2, middle), f2, low);
}
// 2^x for x <= 1; below -126 the result fades to 0.
FS_INLINE vf exp2(vf x) {
  vf n = _mm512_roundscale_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
  vf f = _mm512_sub_ps(x, n);
  const vf p = exp2_fraction(f);
  return _mm512_scalef_ps(p, n);
}
FS_INLINE vf exp2_normal(vf x) { return exp2(x); }
FS_INLINE float sum(vf a) { return _mm512_reduce_add_ps(a); }
// out[i] = sum of the lanes of v[i], i < 16.
FS_INLINE vf sums16(const vf* v) {
  vf quad[4];
  for (int j = 0; j < 4; j++) {
    const vf *a = v + 4 * 0 + j, *b = v + 4 * 1 + j, *c = v + 4 * 2 + j, *d = v + 4 * 3 + j;
    vf ab = _mm512_add_ps(_mm512_shuffle_f32x4(*a, *b, 0x44), _mm512_shuffle_f32x4(*a, *b, 0xEE));
    vf cd = _mm512_add_ps(_mm512_shuffle_f32x4(*c, *d, 0x44), _mm512_shuffle_f32x4(*c, *d, 0xEE));
    quad[j] = _mm512_add_ps(_mm512_shuffle_f32x4(ab, cd, 0x88), _mm512_shuffle_f32x4(ab, cd, 0xDD));
  }
  vf x = _mm512_add_ps(_mm512_unpacklo_ps(quad[0], quad[1]), _mm512_unpackhi_ps(quad[0], quad[1]));
  vf y = _mm512_add_ps(_mm512_unpacklo_ps(quad[2], quad[3]), _mm512_unpackhi_ps(quad[2], quad[3]));
  return _mm512_add_ps(_mm512_shuffle_ps(x, y, 0x44), _mm512_shuffle_ps(x, y, 0xEE));
}
#else
#if defined(FS_AVX2)
constexpr int W = 8;
constexpr int BLOCK_H = 2;
constexpr int TILE_W = 32;
#else
constexpr int W = 4;
constexpr int BLOCK_H = 1;
constexpr int TILE_W = 16;
#endif
typedef float vf __attribute__((vector_size(W * 4)));
typedef int32_t vi __attribute__((vector_size(W * 4)));
using vm = vi;
// Written out: `vf{} + x` is an addition, and 0 + x is not x for x = -0.
#if defined(FS_AVX2)
FS_INLINE vf set1(float x) { return _mm256_set1_ps(x); }
#else
FS_INLINE vf set1(float x) { return vf{x, x, x, x}; }
#endif
FS_INLINE vf zero() { return vf{}; }
FS_INLINE vi set1i(int32_t x) { return vi{} + x; }
FS_INLINE vf load(const float* p) { return *(const vf*)p; }
FS_INLINE void store(float* p, vf a) { *(vf*)p = a; }
FS_INLINE vf loadu(const float* p) {
  vf a;
  std::memcpy(&a, p, sizeof a);
  return a;
}
FS_INLINE void storeu(float* p, vf a) { std::memcpy(p, &a, sizeof a); }
FS_INLINE vi loadi(const int32_t* p) { return *(const vi*)p; }
FS_INLINE void storei(int32_t* p, vi a) { *(vi*)p = a; }
#if defined(FS_AVX2)
FS_INLINE vf fma(vf a, vf b, vf c) { return _mm256_fmadd_ps(a, b, c); }
FS_INLINE vf fnma(vf a, vf b, vf c) { return _mm256_fnmadd_ps(a, b, c); }
FS_INLINE vf vmin(vf a, vf b) { return _mm256_min_ps(a, b); }
FS_INLINE vf vmax(vf a, vf b) { return _mm256_max_ps(a, b); }
FS_INLINE vf vsqrt(vf a) { return _mm256_sqrt_ps(a); }
FS_INLINE bool any(vm a) { return _mm256_movemask_ps((__m256)a) != 0; }
FS_INLINE bool all(vm a) { return _mm256_movemask_ps((__m256)a) == 0xff; }
#else
FS_INLINE vf fma(vf a, vf b, vf c) { return a * b + c; }
FS_INLINE vf fnma(vf a, vf b, vf c) { return c - a * b; }
FS_INLINE vf vmin(vf a, vf b) { return a < b ? a : b; }
FS_INLINE vf vmax(vf a, vf b) { return a > b ? a : b; }
FS_INLINE vf vsqrt(vf a) {
  for (int i = 0; i < W; i++) a[i] = __builtin_sqrtf(a[i]);
  return a;
}
#if defined(__SSE2__)
FS_INLINE bool any(vm a) { return _mm_movemask_ps((__m128)a) != 0; }
FS_INLINE bool all(vm a) { return _mm_movemask_ps((__m128)a) == 0xf; }
#else
FS_INLINE bool any(vm a) { return (a[0] | a[1] | a[2] | a[3]) != 0; }
FS_INLINE bool all(vm a) { return (a[0] & a[1] & a[2] & a[3]) != 0; }
#endif
#endif
FS_INLINE vf vabs(vf a) { return (vf)((vi)a & 0x7fffffff); }
FS_INLINE vm ge(vf a, vf b) { return a >= b; }
FS_INLINE vm gt(vf a, vf b) { return a > b; }
FS_INLINE vm le(vf a, vf b) { return a <= b; }
FS_INLINE vm gti(vi a, vi b) { return a > b; }
FS_INLINE vm eqi(vi a, vi b) { return a == b; }
FS_INLINE vm both(vm a, vm b) { return a & b; }
FS_INLINE vm but(vm a, vm b) { return a & ~b; }
FS_INLINE vf keep(vm m, vf a) { return (vf)(m & (vi)a); }
FS_INLINE vf select(vm m, vf a, vf b) { return m ? a : b; }
FS_INLINE vi selecti(vm m, vi a, vi b) { return m ? a : b; }
// 2^f on [-0.5, 0.5]: minimax polynomial of degree 5, error 9e-8, its terms in pairs because latency is what takes
// time.
FS_INLINE vf exp2_fraction(vf f) {
  const vf f2 = f * f;
  const vf low = fma(set1(6.931469776e-1f), f, set1(1.0f)),
           middle = fma(set1(5.550733778e-2f), f, set1(2.402224208e-1f));
  const vf high = fma(set1(1.326472037e-3f), f, set1(9.671513022e-3f));
  return fma(fma(high, f2, middle), f2, low);
}
// 2^x for -126 <= x <= 1; below that anything at all. The sum with 1.5·2^23 rounds to the nearest integer and leaves it
// in the low bits. This relies on strict IEEE addition: -ffast-math would fold it away.
FS_INLINE vf exp2_normal(vf x) {
  const vf magic = set1(12582912.0f);
  vf t = x + magic;
  vf f = x - (t - magic);
  const vf p = exp2_fraction(f);
  return (vf)((vi)p + ((vi)t << 23));
}
// 2^x for x <= 1; below -126 as at -126.
FS_INLINE vf exp2(vf x) { return exp2_normal(vmax(x, set1(-126.0f))); }
FS_INLINE float sum(vf a) {
  float s[W];
  storeu(s, a);
  for (int n = W / 2; n; n /= 2)
    for (int i = 0; i < n; i++) s[i] += s[i + n];
  return s[0];
}
#endif

// out[i] = sum of the lanes of v[i], i < n; n is rounded up to a multiple of W by the caller's arrays.
FS_INLINE void store_sums(const vf* v, int n, float* out) {
#if defined(FS_AVX512)
  for (int i = 0; i < n; i += 16) storeu(out + i, sums16(v + i));
#elif defined(FS_AVX2)
  for (int i = 0; i < n; i += 8) {
    __m256 pair[4];
    for (int j = 0; j < 4; j++)
      pair[j] = _mm256_add_ps(_mm256_permute2f128_ps(v[i + j], v[i + 4 + j], 0x20),
                              _mm256_permute2f128_ps(v[i + j], v[i + 4 + j], 0x31));
    __m256 x = _mm256_add_ps(_mm256_unpacklo_ps(pair[0], pair[1]), _mm256_unpackhi_ps(pair[0], pair[1]));
    __m256 y = _mm256_add_ps(_mm256_unpacklo_ps(pair[2], pair[3]), _mm256_unpackhi_ps(pair[2], pair[3]));
    storeu(out + i, _mm256_add_ps(_mm256_shuffle_ps(x, y, 0x44), _mm256_shuffle_ps(x, y, 0xEE)));
  }
#else
  for (int i = 0; i < n; i++) out[i] = sum(v[i]);
#endif
}

// Bit i of the result = bit `bit` of byte i, i < 64.
FS_INLINE uint64_t column(const uint8_t* bytes, int bit) {
#if defined(FS_AVX512)
  return _mm512_test_epi8_mask(_mm512_loadu_si512(bytes), _mm512_set1_epi8((char)(1 << bit)));
#elif defined(FS_AVX2)
  const __m128i shift = _mm_cvtsi32_si128(7 - bit);
  const __m256i low = _mm256_loadu_si256((const __m256i*)bytes),
                high = _mm256_loadu_si256((const __m256i*)(bytes + 32));
  return (uint32_t)_mm256_movemask_epi8(_mm256_sll_epi16(low, shift)) |
         (uint64_t)(uint32_t)_mm256_movemask_epi8(_mm256_sll_epi16(high, shift)) << 32;
#elif defined(__SSE2__)
  const __m128i shift = _mm_cvtsi32_si128(7 - bit);
  uint64_t out = 0;
  for (int i = 0; i < 4; i++) {
    const __m128i part = _mm_loadu_si128((const __m128i*)(bytes + 16 * i));
    out |= (uint64_t)(uint32_t)_mm_movemask_epi8(_mm_sll_epi16(part, shift)) << (16 * i);
  }
  return out;
#else
  uint64_t out = 0;
  for (int i = 0; i < 64; i++) out |= (uint64_t)(bytes[i] >> bit & 1) << i;
  return out;
#endif
}

// Doubles, for what is done once per Gaussian: needles and large images need the digits.
constexpr int DW = W / 2 < 2 ? 2 : W / 2;
typedef double vd __attribute__((vector_size(DW * 8)));
typedef int64_t vl __attribute__((vector_size(DW * 8)));
FS_INLINE vd set1d(double x) {
  vd a;
  for (int i = 0; i < DW; i++) a[i] = x;
  return a;
}
FS_INLINE vd vsqrt(vd a) {
#if defined(FS_AVX512)
  return (vd)_mm512_sqrt_pd((__m512d)a);
#elif defined(FS_AVX2)
  return (vd)_mm256_sqrt_pd((__m256d)a);
#else
  for (int i = 0; i < DW; i++) a[i] = __builtin_sqrt(a[i]);
  return a;
#endif
}
// If a is NaN, b.
FS_INLINE vd vmax(vd a, vd b) {
#if defined(FS_AVX512)
  return (vd)_mm512_max_pd((__m512d)a, (__m512d)b);
#elif defined(FS_AVX2)
  return (vd)_mm256_max_pd((__m256d)a, (__m256d)b);
#else
  return a > b ? a : b;
#endif
}
FS_INLINE vd vmin(vd a, vd b) {
#if defined(FS_AVX512)
  return (vd)_mm512_min_pd((__m512d)a, (__m512d)b);
#elif defined(FS_AVX2)
  return (vd)_mm256_min_pd((__m256d)a, (__m256d)b);
#else
  return a < b ? a : b;
#endif
}
FS_INLINE vd vabs(vd a) { return (vd)((vl)a & INT64_MAX); }

}  // namespace FS_NS
