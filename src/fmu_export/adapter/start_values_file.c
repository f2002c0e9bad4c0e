/* Start values and names of a prebuilt binary: the file start_values.bin in the FMU's resources folder.
 *
 * Bytes, all numbers little-endian: "FMUstart", uint32 format 2, uint32 count, GUID in FMU_GUID_SIZE bytes padded by
 * zeros, count times an IEEE 754 double, uint32 size, and in that many bytes count times a name in UTF-8 with a zero
 * behind it, empty for a variable that is not shown.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmu_unit.h"

#if defined _WIN32
#include <windows.h>
#endif

enum { PATH_SIZE = 4096, HEADER_SIZE = 16 + FMU_GUID_SIZE, FORMAT = 2 };

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

/* Length of the character of UTF-8 at `c`, which a zero byte ends at the latest; 0 for none, and for control
 * characters. */
static size_t character(const unsigned char *c)
{
    static const uint32_t least[] = {0x20, 0xA0, 0x800, 0x10000};
    const size_t more = c[0] < 0x80u ? 0 : c[0] < 0xE0u ? 1 : c[0] < 0xF0u ? 2 : 3;
    uint32_t code = more == 0 ? c[0] : c[0] & (0x3Fu >> more);
    if (c[0] == 0x7Fu || (c[0] >= 0x80u && c[0] < 0xC2u) || c[0] > 0xF4u) {
        return 0;
    }
    for (size_t i = 1; i <= more; i++) {
        if ((c[i] & 0xC0u) != 0x80u) {
            return 0;
        }
        code = code << 6 | (c[i] & 0x3Fu);
    }
    return code < least[more] || code > 0x10FFFFu || (code >= 0xD800u && code < 0xE000u) ? 0 : more + 1;
}

/* Take apart `size` bytes that end with a zero; 0 where they are not `count` names. */
static int take_names(const char *texts, size_t size, const char **names, size_t count)
{
    size_t at = 0;
    for (size_t i = 0; i < count; i++) {
        const size_t begin = at;
        if (at >= size) {
            return 0;
        }
        while (texts[at] != '\0') {
            const size_t length = character((const unsigned char *)texts + at);
            if (length == 0) {
                return 0;
            }
            at += length;
        }
        if (at - begin >= FMU_NAME_SIZE) {
            return 0;
        }
        names[i] = at > begin ? texts + begin : NULL;
        at++;
    }
    return at == size;
}

static int read_names(FILE *file, fmu_start *start, size_t count)
{
    unsigned char bytes[4];
    if (fread(bytes, 1, sizeof bytes, file) != sizeof bytes) {
        return 0;
    }
    const size_t size = (size_t)little_endian(bytes, 4);
    if (size < count || size / FMU_NAME_SIZE > count) {
        return 0;
    }
    start->texts = malloc(size + 1);
    if (start->texts == NULL || fread(start->texts, 1, size, file) != size) {
        return 0;
    }
    start->texts[size] = '\0'; /* no name runs beyond */
    return start->texts[size - 1] == '\0' && take_names(start->texts, size, start->names, count);
}

static int parse(FILE *file, fmu_start *start, size_t count)
{
    unsigned char head[HEADER_SIZE], number[8];
    if (fread(head, 1, sizeof head, file) != sizeof head || memcmp(head, "FMUstart", 8) != 0
        || little_endian(head + 8, 4) != FORMAT || little_endian(head + 12, 4) != count
        || head[HEADER_SIZE - 1] != '\0') {
        return 0;
    }
    memcpy(start->guid, head + 16, FMU_GUID_SIZE);
    for (size_t i = 0; i < count; i++) {
        if (fread(number, 1, sizeof number, file) != sizeof number) {
            return 0;
        }
        const uint64_t bits = little_endian(number, 8);
        memcpy(&start->values[i], &bits, sizeof bits);
    }
    return read_names(file, start, count) && fread(number, 1, 1, file) == 0;
}

int fmu_load_start_values(const char *resource_location, fmu_start *start, size_t count, char *problem,
                          size_t problem_size)
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
    const int good = parse(file, start, count);
    fclose(file);
    if (!good) {
        snprintf(problem, problem_size, "this FMU's start values must be in its resources, found another content of %s",
                 path);
        return -1;
    }
    return 0;
}
