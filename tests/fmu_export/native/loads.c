/* Loads start values from each folder, given as URIs behind their count, and prints 1 and what it read, or 0. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_unit.h"

static void load(const char *folder, size_t count)
{
    char problem[512];
    fmu_start start = {"", calloc(count, sizeof(double)), calloc(count, sizeof(char *)), NULL};
    const int loaded = fmu_load_start_values(folder, &start, count, problem, sizeof problem) == 0;
    double sum = 0.0;
    size_t length = 0;
    for (size_t i = 0; loaded && i < count; i++) {
        sum += start.values[i] > 0.0;
        length += start.names[i] == NULL ? 0 : strlen(start.names[i]);
    }
    printf("%d %g %lu\n", loaded, sum, (unsigned long)length);
    free(start.values);
    free(start.names);
    free(start.texts);
}

int main(int count, char **arguments)
{
    for (int i = 2; i < count; i++) {
        load(arguments[i], (size_t)atoi(arguments[1]));
    }
    return 0;
}
