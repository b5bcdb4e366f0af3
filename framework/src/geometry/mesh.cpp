#include <shadelab/mesh.hpp>

#include <shadelab/error.hpp>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <string_view>
#include <tuple>

namespace shadelab {

namespace {

// ---- 1. the file as it stands

struct Corner {
    int position, normal;
};

struct Face {
    int line;                ///< for messages
    int corners;             ///< how many of ObjFile::corners are its own
    int positions, normals;  ///< how many stood above it: negative numbers count back from here
};

struct ObjFile {
    std::string name;
    std::vector<glm::dvec3> positions, normals;
    std::vector<Face> faces;
    /// Face after face. As written: counted from 1, or negative to count back. From resolve_numbers on: indices from 0.
    std::vector<Corner> corners;
    bool materials = false;
    std::vector<std::string> groups;   ///< smoothing groups other than "off"
    int unknown = 0, bad_normals = 0;  ///< lines that begin with no word of OBJ files; normals that are no direction
    int crossed = 0;                   ///< polygons that cross themselves
    int first_unknown = 0, first_bad = 0, first_crossed = 0;  ///< the lines of the first
    std::string unknown_word;

    [[noreturn]] void fail(int line, const std::string& what) const {
        throw InputError(name + ":" + std::to_string(line) + ": " + what);
    }
};

constexpr int no_normal = std::numeric_limits<int>::min();  ///< in a corner that names none

std::string read_text(const std::filesystem::path& file, const std::string& where) {
    std::ifstream in(file, std::ios::binary);
    std::error_code not_a_file;
    const uintmax_t size = std::filesystem::file_size(file, not_a_file);
    std::string text(not_a_file ? 0 : size, '\0');
    if (not_a_file || !in.read(text.data(), std::streamsize(size)))
        throw InputError((where.empty() ? "" : where + ": ") + "the mesh " + file.string() +
                         " cannot be read; does the file exist? (./shadelab doctor says which meshes are there)");
    return text;
}

/// A place in the text. Only next_line passes the end of a line or the comment before it.
struct Cursor {
    const char *at, *end;
    int line = 1;

    static bool is_line_end(char c) { return c == '\n' || c == '\r'; }
    static bool is_blank(char c) { return c == ' ' || c == '\t'; }
    bool starts(char c) const { return at != end && *at == c; }
    bool line_ends() const { return at == end || is_line_end(*at) || *at == '#'; }
    /// A backslash at the very end of a line: the next one goes on with it.
    bool continues() const { return starts('\\') && at + 1 != end && is_line_end(at[1]); }
    bool word_ends() const { return line_ends() || is_blank(*at) || continues(); }

    void pass_line_end() {
        if (*at++ == '\r' && starts('\n')) ++at;
        ++line;
    }
    void skip_blanks() {
        for (;;) {
            if (continues())
                ++at, pass_line_end();
            else if (at != end && is_blank(*at))
                ++at;
            else
                return;
        }
    }
    std::string_view word() {
        const char* const from = at;
        while (!word_ends()) ++at;
        return {from, at};
    }
    void next_line() {
        for (bool comment = false; at != end && !is_line_end(*at);) {
            comment |= *at == '#';
            if (!comment && continues())
                ++at, pass_line_end();
            else
                ++at;
        }
        if (at != end) pass_line_end();
    }

    /// Whether a number stands here. "nan", "inf" and what is too large for a double are numbers, if not finite ones;
    /// "1.#IND" and its like, which an old library wrote for them, too.
    bool read(double& value) {
        const char* const from = at + starts('+');  // from_chars takes no plus
        const auto [rest, error] = std::from_chars(from, end, value);
        if (error == std::errc() && rest != end && *rest == '#' && rest > from && rest[-1] == '.') {
            value = std::numeric_limits<double>::quiet_NaN();
            for (at = rest + 1; at != end && std::isalnum(static_cast<unsigned char>(*at));) ++at;
            return word_ends();
        }
        if (error == std::errc::invalid_argument) return false;
        if (error == std::errc::result_out_of_range) {
            const bool tiny = std::string_view(from, rest).find('-', 1) != std::string_view::npos;
            value = tiny ? 0 : std::numeric_limits<double>::infinity();
        }
        at = rest;
        return word_ends();
    }
    bool read(glm::dvec3& value) {
        for (int k = 0; k < 3; ++k) {
            skip_blanks();
            if (!read(value[k])) return false;
        }
        return true;
    }
    bool read(int& value) {
        const auto [rest, error] = std::from_chars(at, end, value);
        at = rest;
        return error == std::errc();
    }
    /// Whether a corner of a face stands here: v, v/t, v//n or v/t/n, with or without a slash at the end. The t is passed
    /// over: no scene has textures.
    bool read(Corner& corner) {
        corner.normal = no_normal;
        if (!read(corner.position)) return false;
        if (starts('/')) {
            ++at;
            int texture;
            read(texture);
            if (starts('/')) {
                ++at;
                if (!word_ends() && !read(corner.normal)) return false;
            }
        }
        return word_ends();
    }
};

bool finite(glm::dvec3 p) { return std::isfinite(p.x) && std::isfinite(p.y) && std::isfinite(p.z); }

bool is_direction(glm::dvec3 normal) { return finite(normal) && glm::length(normal) > 0; }

/// What an OBJ file may hold besides, and what changes no triangle: texture coordinates, names, lines, points, free forms.
bool is_passed_over(std::string_view statement) {
    constexpr std::string_view words[] = {"vt",    "vp",       "l",         "p",          "g",      "o",      "usemtl",
                                          "mg",    "cstype",   "deg",       "bmat",       "step",   "curv",   "curv2",
                                          "surf",  "parm",     "trim",      "hole",       "scrv",   "sp",     "end",
                                          "con",   "bevel",    "c_interp",  "lod",        "usemap", "maplib", "ctech",
                                          "stech", "d_interp", "trace_obj", "shadow_obj", "call",   "csh"};
    return std::find(std::begin(words), std::end(words), statement) != std::end(words);
}

/// For a message: what a terminal would not show is a question mark.
std::string printable(std::string_view word) {
    std::string out(word.substr(0, 20));
    std::replace_if(out.begin(), out.end(), [](unsigned char c) { return c < 0x20 || c > 0x7e; }, '?');
    return out;
}

/// One pass, and no locale: std::strtod would read "0.5" as 0 where the decimal point is a comma.
ObjFile parse(const std::string& name, const std::string& text) {
    ObjFile obj;
    obj.name = name;
    const size_t mark = text.rfind("\xef\xbb\xbf", 0) == 0 ? 3 : 0;  // some editors begin a file with it
    for (Cursor in{text.data() + mark, text.data() + text.size()}; in.at != in.end; in.next_line()) {
        in.skip_blanks();
        const std::string_view statement = in.word();
        if (statement == "v") {
            if (!in.read(obj.positions.emplace_back())) obj.fail(in.line, "a vertex takes three numbers");
        } else if (statement == "vn") {
            if (!in.read(obj.normals.emplace_back())) obj.fail(in.line, "a normal takes three numbers");
            if (!is_direction(obj.normals.back()) && ++obj.bad_normals == 1) obj.first_bad = in.line;
        } else if (statement == "f") {
            Face& face = obj.faces.emplace_back(Face{in.line, 0, int(obj.positions.size()), int(obj.normals.size())});
            for (in.skip_blanks(); !in.line_ends(); in.skip_blanks()) {
                Cursor start = in;
                if (!in.read(obj.corners.emplace_back()))
                    obj.fail(in.line, "\"" + std::string(start.word()) + "\" is not a corner: v, v/t, v//n or v/t/n");
                ++face.corners;
            }
        } else if (statement == "mtllib") {
            obj.materials = true;  // not even opened: the scene file gives the materials
        } else if (statement == "s") {
            in.skip_blanks();
            const std::string group(in.word());
            const bool fresh = std::find(obj.groups.begin(), obj.groups.end(), group) == obj.groups.end();
            if (group != "off" && group != "0" && fresh) obj.groups.push_back(group);
        } else if (!statement.empty() && !is_passed_over(statement) && ++obj.unknown == 1) {
            obj.first_unknown = in.line;
            obj.unknown_word = printable(statement);
        }
    }
    return obj;
}

/// Only now, because vertices may follow the faces that refer to them.
void resolve_numbers(ObjFile& obj) {
    const auto resolve = [&](const Face& face, const char* what, int number, int above, size_t there) {
        const int64_t index = number > 0 ? int64_t(number) - 1 : int64_t(above) + number;
        if (number == 0 || index < 0 || index >= int64_t(there))
            obj.fail(face.line, std::string("the face refers to ") + what + " " + std::to_string(number) +
                                    ", but the file has " + std::to_string(there) +
                                    (number == 0 ? "; they are counted from 1" : ""));
        return int(index);
    };
    Corner* corner = obj.corners.data();
    for (const Face& face : obj.faces)
        for (int k = 0; k < face.corners; ++k, ++corner) {
            corner->position = resolve(face, "vertex", corner->position, face.positions, obj.positions.size());
            if (obj.normals.empty())
                corner->normal = no_normal;  // nothing to refer to: what the numbers meant is not in the file
            else if (corner->normal != no_normal)
                corner->normal = resolve(face, "normal", corner->normal, face.normals, obj.normals.size());
        }
}

// ---- 2. triangles: three corners each

/// Not normalised; its length is twice the area. One point is subtracted in double, so large coordinates do not tilt it.
glm::dvec3 area_normal(const glm::dvec3& a, const glm::dvec3& b, const glm::dvec3& c) {
    return glm::cross(b - a, c - a);
}

glm::dvec3 area_normal(const ObjFile& obj, const Corner* triangle) {
    return area_normal(obj.positions[triangle[0].position], obj.positions[triangle[1].position],
                       obj.positions[triangle[2].position]);
}

/// Along the shorter diagonal, for the rounder triangles; along the other where the shorter one lies outside a concave quad.
/// False for a quad that crosses itself: both lie outside.
template <class Emit>
bool cut_quad(const ObjFile& obj, const Corner* q, const Emit& emit) {
    const glm::dvec3 p[] = {obj.positions[q[0].position], obj.positions[q[1].position], obj.positions[q[2].position],
                            obj.positions[q[3].position]};
    const auto bend =
        [&](int i) {  // along the diagonal from corner i: negative where the triangles fold over, 0 where one is flat
            return glm::dot(area_normal(p[i], p[i + 1], p[i + 2]), area_normal(p[i], p[i + 2], p[(i + 3) % 4]));
        };
    const glm::dvec3 d02 = p[2] - p[0], d13 = p[3] - p[1];
    const bool shorter02 = glm::dot(d02, d02) < glm::dot(d13, d13);
    const double shorter = bend(shorter02 ? 0 : 1), longer = bend(shorter02 ? 1 : 0);
    const bool along_shorter = shorter > 0 || !(longer > shorter);
    if (along_shorter == shorter02) {
        emit(q[0], q[1], q[2]);
        emit(q[0], q[2], q[3]);
    } else {
        emit(q[0], q[1], q[3]);
        emit(q[1], q[2], q[3]);
    }
    return !(shorter < 0 && longer < 0);
}

/// What is left of a polygon from which triangles of three neighbours ("ears") are cut, seen against its normal.
struct Outline {
    const ObjFile& obj;
    std::vector<Corner> rest;
    glm::dvec3 normal{0};  ///< of the whole: each fan triangle outside a concave polygon counts negative
    bool repeats = false;  ///< whether two corners stand at one position

    Outline(const ObjFile& file, const Corner* from, int count) : obj(file), rest(from, from + count) {
        for (size_t i = 1; i + 1 < rest.size(); ++i) normal += area_normal(at(0), at(i), at(i + 1));
        std::vector<glm::dvec3> sorted;
        for (const Corner& corner : rest) sorted.push_back(obj.positions[corner.position]);
        std::sort(sorted.begin(), sorted.end(), [](const glm::dvec3& a, const glm::dvec3& b) {
            return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z);
        });
        repeats = std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end();
    }

    glm::dvec3 at(size_t i) const { return obj.positions[rest[i % rest.size()].position]; }
    double side(glm::dvec3 a, glm::dvec3 b, glm::dvec3 p) const { return glm::dot(area_normal(a, b, p), normal); }
    double side(size_t i) const { return side(at(i), at(i + 1), at(i + 2)); }

    /// Whether the ear from corner i on holds no other corner, not even at its rim.
    bool is_clear(size_t i) const {
        const glm::dvec3 a = at(i), b = at(i + 1), c = at(i + 2);
        bool clear = side(a, b, c) > 0;
        for (size_t k = 3; clear && k < rest.size(); ++k) {
            const glm::dvec3 p = at(i + k);
            clear = p == a || p == b || p == c || side(a, b, p) < 0 || side(b, c, p) < 0 || side(c, a, p) < 0;
        }
        return clear;
    }

    /// Whether the ear lies inside of a polygon that may touch itself: no edge passes through it, so that it is inside as a whole
    /// or not at all, and its middle is inside.
    bool is_inside(size_t i) const {
        const glm::dvec3 t[] = {at(i), at(i + 1), at(i + 2)};
        const double area = side(i);
        if (!(area > 0)) return false;
        for (size_t k = 0; k < rest.size(); ++k) {
            double enters = 0, leaves = 1;  // the part of the edge that lies within
            for (int e = 0; e < 3; ++e) {
                const double from = side(t[e], t[(e + 1) % 3], at(k)) / area - rounding,
                             to = side(t[e], t[(e + 1) % 3], at(k + 1)) / area - rounding;
                if (from <= 0 && to <= 0)
                    leaves = 0;
                else if (from <= 0)
                    enters = std::max(enters, from / (from - to));
                else if (to <= 0)
                    leaves = std::min(leaves, from / (from - to));
            }
            if (leaves - enters > rounding) return false;
        }
        return winding((t[0] + t[1] + t[2]) / 3.0) > 0;
    }

    /// How often the outline goes round a point, counted the way of the normal.
    int winding(glm::dvec3 p) const {
        const glm::dvec3 size = glm::abs(normal);
        const int w = size.x > size.y && size.x > size.z ? 0
                      : size.y > size.z                  ? 1
                                                         : 2,
                  u = (w + 1) % 3, v = (w + 2) % 3;
        int turns = 0;
        for (size_t k = 0; k < rest.size(); ++k) {
            const glm::dvec3 a = at(k) - p, b = at(k + 1) - p;
            if ((a[v] > 0) == (b[v] > 0)) continue;  // does not meet the line through p along u
            const double left = (a[u] * b[v] - a[v] * b[u]) * (b[v] > a[v] ? 1 : -1);
            if (left > 0) turns += b[v] > a[v] ? 1 : -1;
        }
        return normal[w] > 0 ? turns : -turns;
    }

    /// Where to cut next: an ear that is clear, or one whose rim another part touches, or a corner that spans no area.
    /// rest.size() for a polygon that crosses itself.
    size_t next_ear() const {
        const size_t n = rest.size();
        for (size_t i = 0; i < n; ++i)
            if (is_clear(i) && (!repeats || is_inside(i))) return i;
        for (size_t i = 0; i < n; ++i)
            if (is_inside(i)) return i;
        for (size_t i = 0; i < n; ++i)
            if (std::abs(side(i)) <= rounding * glm::dot(normal, normal)) return i;
        return n;
    }

    static constexpr double rounding = 1e-9;  ///< of what is 0 but for it, beside 1
};

/// Of a convex polygon this leaves a fan. False for one that crosses itself.
template <class Emit>
bool cut_polygon(Outline outline, const Emit& emit) {
    std::vector<Corner>& rest = outline.rest;
    bool simple = glm::length(outline.normal) != 0;
    while (rest.size() > 3) {
        const size_t ear = simple ? outline.next_ear() : rest.size();
        simple &= ear < rest.size();
        emit(rest[ear % rest.size()], rest[(ear + 1) % rest.size()], rest[(ear + 2) % rest.size()]);
        rest.erase(rest.begin() + long((ear + 1) % rest.size()));
    }
    emit(rest[0], rest[1], rest[2]);
    return simple && !(outline.side(0) < -Outline::rounding * glm::dot(outline.normal, outline.normal));
}

/// What cannot be drawn is only counted.
std::vector<Corner> triangulate(ObjFile& obj, int& dropped) {
    std::vector<Corner> triangles;
    triangles.reserve(obj.corners.size());
    const auto emit = [&](Corner a, Corner b, Corner c) {
        const Corner triangle[] = {a, b, c};
        const double size = glm::length(area_normal(obj, triangle));
        if (size > 0 && std::isfinite(size))
            triangles.insert(triangles.end(), triangle, triangle + 3);
        else
            ++dropped;
    };
    const Corner* corner = obj.corners.data();
    for (const Face& face : obj.faces) {
        const size_t before = triangles.size();
        bool simple = true;
        if (face.corners < 3)
            ++dropped;
        else if (face.corners == 3)
            emit(corner[0], corner[1], corner[2]);
        else if (face.corners == 4)
            simple = cut_quad(obj, corner, emit);
        else
            simple = cut_polygon(Outline(obj, corner, face.corners), emit);
        // One without area, or with coordinates that are not finite, gives no triangle.
        if (!simple && triangles.size() > before && ++obj.crossed == 1) obj.first_crossed = face.line;
        corner += face.corners;
    }
    return triangles;
}

/// What is subtracted from the positions before they are rounded.
glm::dvec3 origin_of(const ObjFile& obj, const std::vector<Corner>& triangles) {
    // Where a mesh lies farther out than this many times its size, float32 would spend more than 4 of its 24 bits on the
    // place and fewer than 20 on the shape. Meshes that lie nearer, which is nearly all, keep the coordinates of their file.
    constexpr double far_out = 16;
    constexpr double infinity = std::numeric_limits<double>::infinity();
    glm::dvec3 low(infinity), high(-infinity);
    for (const Corner& corner : triangles) {
        low = glm::min(low, obj.positions[corner.position]);
        high = glm::max(high, obj.positions[corner.position]);
    }
    const glm::dvec3 centre = low + (high - low) / 2.0;
    return glm::length(centre) > far_out * glm::length(high - low) ? centre : glm::dvec3(0);
}

// ---- 3. normals

/// The angle-weighted sums of face normals at each position, and the sums of the weights.
void accumulate_normals(const ObjFile& obj, const std::vector<Corner>& triangles, std::vector<glm::dvec3>& sums,
                        std::vector<double>& weights) {
    sums.assign(obj.positions.size(), glm::dvec3(0));
    weights.assign(obj.positions.size(), 0);
    for (size_t t = 0; t < triangles.size(); t += 3) {
        const glm::dvec3 face = glm::normalize(area_normal(obj, &triangles[t]));
        for (size_t k = 0; k < 3; ++k) {
            const int p = triangles[t + k].position;
            const glm::dvec3 a = obj.positions[triangles[t + (k + 1) % 3].position] - obj.positions[p];
            const glm::dvec3 b = obj.positions[triangles[t + (k + 2) % 3].position] - obj.positions[p];
            // atan2 and not acos: exact for the thin angles of slivers, where a cosine has no digits left.
            const double angle = std::atan2(glm::length(glm::cross(a, b)), glm::dot(a, b));
            sums[p] += angle * face;
            weights[p] += angle;
        }
    }
}

}  // namespace

Mesh load_mesh(const std::filesystem::path& file, Normals mode, const std::string& where) {
    ObjFile obj = parse(file.string(), read_text(file, where));
    resolve_numbers(obj);
    if (std::none_of(obj.faces.begin(), obj.faces.end(), [](const Face& face) { return face.corners >= 3; }))
        throw InputError(file.string() + ": holds no faces");

    Mesh mesh;
    const auto note = [&](const std::string& text) { mesh.notes.push_back(file.filename().string() + ": " + text); };
    if (obj.materials) note("materials (mtllib) ignored; the scene file gives them");
    const std::vector<Corner> triangles = triangulate(obj, mesh.dropped_triangles);
    mesh.origin = origin_of(obj, triangles);
    if (mesh.dropped_triangles > 0)
        note(std::to_string(mesh.dropped_triangles) +
             " triangles without area or with coordinates that are not finite were left out");

    if (obj.crossed)
        note("line " + std::to_string(obj.first_crossed) + ": this polygon crosses itself" +
             (obj.crossed > 1 ? ", the first of " + std::to_string(obj.crossed) : "") +
             "; it is cut into triangles that may reach beyond it");
    if (obj.unknown)
        note("line " + std::to_string(obj.first_unknown) + ": \"" + obj.unknown_word +
             "\" begins no line of an OBJ file; " +
             (obj.unknown == 1 ? "it is" : std::to_string(obj.unknown) + " such lines are") + " ignored");
    if (mode == Normals::smooth && obj.groups.size() > 1)
        note("its " + std::to_string(obj.groups.size()) +
             " smoothing groups (s) are ignored: normals are smooth across them, too");

    if (mode == Normals::file &&
        std::any_of(triangles.begin(), triangles.end(), [](const Corner& c) { return c.normal == no_normal; })) {
        note("normals = \"file\", but not every face has some; smooth ones are used instead");
        mode = Normals::smooth;
    }
    const auto from_file = [&](const Corner& c) {
        return mode == Normals::file && is_direction(obj.normals[c.normal]);
    };
    const bool mended = mode == Normals::file && !std::all_of(triangles.begin(), triangles.end(), from_file);
    if (mended)
        note("line " + std::to_string(obj.first_bad) + ": a normal that is no direction (nan, or 0 0 0)" +
             (obj.bad_normals > 1 ? ", the first of " + std::to_string(obj.bad_normals) : "") +
             "; smooth ones are used there");

    std::vector<glm::dvec3> sums;
    std::vector<double> weights;
    std::vector<char> cancelled(obj.positions.size(), false);
    if (mode == Normals::smooth || mended) {
        accumulate_normals(obj, triangles, sums, weights);
        for (size_t p = 0; p < sums.size(); ++p) {
            // Below this the direction of the sum is rounding noise: float32 inputs carry about 1e-7.
            cancelled[p] = weights[p] > 0 && glm::length(sums[p]) < 1e-6 * weights[p];
            mesh.cancelled_normals += cancelled[p];
        }
    }

    // One output vertex per distinct (position, normal), found again in a list for each position, which is short: it holds one
    // smooth normal or those of the file. Vertices with a face normal of their own stand in no list.
    constexpr uint32_t none = std::numeric_limits<uint32_t>::max();
    std::vector<uint32_t> latest(obj.positions.size(), none), earlier;
    std::vector<int> file_normal;  // of each output vertex
    mesh.indices.reserve(triangles.size());
    for (size_t t = 0; t < triangles.size(); t += 3) {
        for (size_t k = 0; k < 3; ++k) {
            const Corner corner = triangles[t + k];
            const bool given = from_file(corner);
            const bool own = mode == Normals::flat || (!given && cancelled[corner.position]);
            uint32_t vertex = own ? none : latest[corner.position];
            while (mode == Normals::file && vertex != none && file_normal[vertex] != corner.normal)
                vertex = earlier[vertex];
            if (vertex == none) {
                vertex = uint32_t(mesh.positions.size());
                const glm::dvec3 normal = own     ? area_normal(obj, &triangles[t])
                                          : given ? obj.normals[corner.normal]
                                                  : sums[corner.position];
                mesh.positions.push_back(glm::vec3(obj.positions[corner.position] - mesh.origin));
                mesh.normals.push_back(glm::vec3(glm::normalize(normal)));
                earlier.push_back(latest[corner.position]);
                file_normal.push_back(corner.normal);
                if (!own) latest[corner.position] = vertex;
            }
            mesh.indices.push_back(vertex);
        }
        const uint32_t* corner = &mesh.indices[t];
        for (int k = 0; k < 3; ++k)
            mesh.opposing_normals |= glm::dot(mesh.normals[corner[k]], mesh.normals[corner[(k + 1) % 3]]) < 0;
    }
    if (mesh.cancelled_normals > 0)
        note(std::to_string(mesh.cancelled_normals) + " vertices whose face normals cancel use the face normals");
    mesh.positions.shrink_to_fit();
    mesh.normals.shrink_to_fit();
    mesh.indices.shrink_to_fit();
    mesh.low = mesh.high = mesh.positions.empty() ? glm::vec3(0) : mesh.positions[0];
    for (const glm::vec3& p : mesh.positions) mesh.low = glm::min(mesh.low, p), mesh.high = glm::max(mesh.high, p);
    return mesh;
}

bool normals_can_cancel(const Mesh& mesh, const glm::dmat4& to_world) {
    // A transform that changes angles can turn harmless normals into opposing ones.
    const glm::dmat3 linear(to_world), gram = glm::transpose(linear) * linear;
    const double off = std::abs(gram[0][1]) + std::abs(gram[0][2]) + std::abs(gram[1][2]) +
                       std::abs(gram[0][0] - gram[1][1]) + std::abs(gram[0][0] - gram[2][2]);
    return mesh.opposing_normals || off > 1e-9 * gram[0][0];
}

}  // namespace shadelab
