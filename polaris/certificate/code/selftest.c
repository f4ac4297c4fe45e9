/* Self-test of @PREFIX@.c: returns 0 if every answer is the expected one, to the last bit. */
#include "@PREFIX@.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

typedef struct {
    int32_t start; /* 1: a new flight begins with this call */
    @PREFIX@_input input;
    @PREFIX@_output expected;
} vector;

@VECTORS@

int main(void)
{
    @PREFIX@_memory memory;
    @PREFIX@_output output;
    int wrong = 0;
    const int count = (int)(sizeof(vectors) / sizeof(vectors[0]));
    for (int i = 0; i < count; i++) {
        const vector *const one = &vectors[i];
        if (one->start != 0) {
            @PREFIX@_start(&memory);
        }
        @PREFIX@_step(&memory, &one->input, &output);
        if ((output.mode != one->expected.mode) || (output.fault != one->expected.fault) ||
            (memcmp(output.command, one->expected.command, sizeof(output.command)) != 0) ||
            (memcmp(&output.margin, &one->expected.margin, sizeof(output.margin)) != 0)) {
            (void)printf("vector %d differs\n", i);
            wrong = 1;
        }
    }
    (void)printf("%d vectors, %s\n", count, (wrong == 0) ? "all as expected" : "FAILED");
    return wrong;
}
