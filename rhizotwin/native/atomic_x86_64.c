/* The one function of libatomic that Dr.Jit's thread pool needs, for Linux on x86-64 without the package libatomic1.

   Build: gcc -Os -mcx16 -shared -nostdlib -fPIC -fcf-protection=none -s -Wl,-soname,libatomic.so.1 \
              -Wl,--version-script=atomic_x86_64.map -Wl,--build-id=none -Wl,-z,noseparate-code \
              -Wl,-z,noexecstack -o atomic_x86_64.so atomic_x86_64.c

   Only processors with cmpxchg16b are served: every x86-64 processor made since 2006, and all that run AVX2. */

#include <stdbool.h>

typedef unsigned __int128 word;

bool exchange(volatile word *object, word *expected, word desired, int success, int failure)
    __asm__("__atomic_compare_exchange_16");

bool exchange(volatile word *object, word *expected, word desired, int success, int failure) {
    (void)success; /* a locked instruction has the strongest order */
    (void)failure;
    unsigned long long low = (unsigned long long)*expected, high = (unsigned long long)(*expected >> 64);
    bool done;
    __asm__ volatile("lock cmpxchg16b %1"
                     : "=@ccz"(done), "+m"(*object), "+a"(low), "+d"(high)
                     : "b"((unsigned long long)desired), "c"((unsigned long long)(desired >> 64))
                     : "memory");
    if (!done) *expected = (word)high << 64 | low;
    return done;
}
