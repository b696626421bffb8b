// The instruction sets for which lanes.cpp was compiled, and the one in use.
#include "lanes.hpp"

#ifdef LANES_OF_X86
#include <cpuid.h>
#endif
#include <cstring>
#include <stdexcept>
#include <string>

namespace pinconsist {
namespace lanes {

extern const Kernel lanes_base;
#ifdef LANES_OF_X86
extern const Kernel lanes_avx2, lanes_avx512;
#endif

namespace {

#ifdef LANES_OF_X86
// What the processor has and the operating system saves; not every compiler's __builtin_cpu_supports works.
struct Processor {
  bool avx2 = false, avx512 = false;

  Processor() {
    unsigned a, b, c, d;
    if (!__get_cpuid(1, &a, &b, &c, &d)) return;
    const bool fma = c & bit_FMA, saves = c & bit_OSXSAVE;
    if (!saves || !fma || !__get_cpuid_count(7, 0, &a, &b, &c, &d)) return;
    unsigned saved, more;
    __asm__("xgetbv" : "=a"(saved), "=d"(more) : "c"(0));
    constexpr unsigned AVX = 0x6, AVX512 = 0xe6, ALL = bit_AVX512F | bit_AVX512DQ | bit_AVX512BW | bit_AVX512VL;
    avx2 = (b & bit_AVX2) && (saved & AVX) == AVX;
    avx512 = avx2 && (b & ALL) == ALL && (saved & AVX512) == AVX512;
  }
};
#endif

struct Known {
  const Kernel *list[MOST_KERNELS] = {&lanes_base};
  int number = 1;

  Known() {
#ifdef LANES_OF_X86
    const Processor processor;
    if (processor.avx2) list[number++] = &lanes_avx2;
    if (processor.avx512) list[number++] = &lanes_avx512;
#endif
  }
};

const Known known;
const Kernel *used = known.list[known.number - 1];

} // namespace

const Kernel &kernel() { return *used; }

void use(const char *name) {
  if (!*name) used = known.list[known.number - 1];
  for (int i = 0; i < known.number; ++i)
    if (!std::strcmp(known.list[i]->name, name)) {
      used = known.list[i];
      return;
    }
  if (*name) throw std::invalid_argument(std::string("no instruction set ") + name);
}

int names(const char **list) {
  for (int i = 0; i < known.number; ++i) list[i] = known.list[i]->name;
  return known.number;
}

} // namespace lanes
} // namespace pinconsist
