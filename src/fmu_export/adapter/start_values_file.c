/* Start values of a prebuilt binary: the file start_values.bin in the FMU's resources folder.
 *
 * Bytes, all numbers little-endian: "FMUstart", uint32 format 1, uint32 count, GUID in FMU_GUID_SIZE bytes padded by zeros,
 * count times an IEEE 754 double.
 */
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include "fmu_unit.h"

#if defined _WIN32
#include <windows.h>
#endif

enum { PATH_SIZE = 4096, HEADER_SIZE = 16 + FMU_GUID_SIZE, FORMAT = 1 };

static int hexadecimal(char c)
{
    if (c >= '0' && c <= '9') {
        return c - '0';
    }
    if (c >= 'a' && c <= 'f') {
        return c - 'a' + 10;
    }
    return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The path, UTF-8, of a file in the folder with the URI `location` (RFC 3986); 0 where it does not fit. */
static int file_path(const char *location, const char *file, char path[PATH_SIZE])
{
    size_t length = 0;
    const char *c = location;
    if (strncmp(c, "file:", 5) == 0) {
        c += 5;
        if (c[0] == '/' && c[1] == '/') {
            c += 2;
            if (strncmp(c, "localhost/", 10) == 0) {
                c += 9;
            }
#if defined _WIN32
            if (c[0] != '/') { /* a host: \\host\share */
                path[length++] = '/';
                path[length++] = '/';
            }
#endif
        }
#if defined _WIN32
        if (c[0] == '/' && c[1] != '\0' && (c[2] == ':' || c[2] == '|')) { /* /C:/folder */
            c++;
        }
#endif
    }
    const int is_uri = c != location;
    for (; *c != '\0'; c++) {
        char byte = *c;
        if (is_uri && byte == '%' && hexadecimal(c[1]) >= 0 && hexadecimal(c[2]) >= 0) {
            byte = (char)(16 * hexadecimal(c[1]) + hexadecimal(c[2]));
            c += 2;
        }
        if (length + 1 >= PATH_SIZE) {
            return 0;
        }
        path[length++] = byte;
    }
    if (length > 0 && path[length - 1] == '/') {
        length--;
    }
    if (length + 1 + strlen(file) >= PATH_SIZE) {
        return 0;
    }
    path[length++] = '/';
    memcpy(path + length, file, strlen(file) + 1);
    return 1;
}

static FILE *open_file(const char *path)
{
#if defined _WIN32
    wchar_t wide[PATH_SIZE];
    if (MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, PATH_SIZE) == 0) {
        return NULL;
    }
    return _wfopen(wide, L"rb");
#else
    return fopen(path, "rb");
#endif
}

static uint64_t little_endian(const unsigned char *bytes, int count)
{
    uint64_t value = 0;
    for (int i = count - 1; i >= 0; i--) {
        value = value << 8 | bytes[i];
    }
    return value;
}

static int parse(FILE *file, char guid[FMU_GUID_SIZE], double *values, size_t count)
{
    unsigned char head[HEADER_SIZE], number[8];
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, "FMUstart", 8) != 0
        || little_endian(head + 8, 4) != FORMAT || little_endian(head + 12, 4) != count
        || head[HEADER_SIZE - 1] != '\0') {
        return 0;
    }
    memcpy(guid, head + 16, FMU_GUID_SIZE);
    for (size_t i = 0; i < count; i++) {
        if (fread(number, 1, sizeof number, file) != sizeof number) {
            return 0;
        }
        const uint64_t bits = little_endian(number, 8);
        memcpy(&values[i], &bits, sizeof bits);
    }
    return fread(number, 1, 1, file) == 0;
}

int fmu_load_start_values(const char *resource_location, char guid[FMU_GUID_SIZE], double *values, size_t count,
                          char *problem, size_t problem_size)
{
    char path[PATH_SIZE];
    if (resource_location == NULL || !file_path(resource_location, "start_values.bin", path)) {
        snprintf(problem, problem_size, "the resource location must be the URI of the FMU's resources folder, found %s",
                 resource_location == NULL ? "none" : resource_location);
        return -1;
    }
    FILE *file = open_file(path);
    if (file == NULL) {
        snprintf(problem, problem_size, "cannot read the FMU's resource %s", path);
        return -1;
    }
    const int good = parse(file, guid, values, count);
    fclose(file);
    if (!good) {
        snprintf(problem, problem_size, "this FMU's start values must be in its resources, found another content of %s", path);
        return -1;
    }
    return 0;
}
