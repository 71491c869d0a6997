/* What all FMUs of this project share: exported names, and what is known of a variable. */

#ifndef FMI_H
#define FMI_H

#include <stddef.h>
#include <stdint.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum Type { NOTHING, REAL, INTEGER, BOOLEAN };
enum Set { NEVER, AT_START, ALWAYS };

/* What is known of a variable: of which type, when it may be set, to what. */
typedef struct {
    const char *name;
    int type, set;
    double start, lowest, highest;
} Kind;

#endif
