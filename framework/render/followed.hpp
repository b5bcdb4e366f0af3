#pragma once
// Follow-through: recorded outputs that stand in for functions of a plugin, and what was asked that is not recorded.

#include <shadelab/error.hpp>
#include <shadelab/plugin_library.hpp>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

namespace shadelab {

inline std::vector<char> read_bytes(const std::string& file) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(file + ": cannot be read");
    return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

/// Answers the calls of a plugin that is followed (plugin.hpp) from recorded outputs, and collects what is not recorded.
/// Arguments count as equal when they are the same float32 numbers: that is how they were recorded. Not for several threads.
template <class Real>
struct Followed {
    struct Record {
        std::map<std::vector<float>, std::vector<Real>> known;
        std::map<std::vector<float>, int64_t> missing;  ///< arguments, and the order in which they came
    };
    static inline std::map<int, Record> records;  ///< by the function's index in the plugin's table
    static inline const plugin::Table<Real>* table;

    static bool answer(int index, const Real* in, Real* out) {
        const auto record = records.find(index);
        if (record == records.end()) return false;
        std::vector<float> key(in, in + table->functions[index].columns_in);
        for (float& value : key) value += 0.0f;  // -0 and 0 are the same argument
        const auto found = record->second.known.find(key);
        if (found == record->second.known.end()) {
            record->second.missing.try_emplace(std::move(key), int64_t(record->second.missing.size()));
            return false;
        }
        std::copy(found->second.begin(), found->second.end(), out);
        return true;
    }
};

/// FOLDER/FUNCTION.known for each function that is to be followed: rows of Real, arguments and then results; may be empty.
template <class Real>
void start_following(const std::string& folder, const PluginLibrary& library) {
    using F = Followed<Real>;
    F::table = &library.table<Real>();
    for (int k = 0; k < F::table->function_count; ++k) {
        const plugin::Function<Real>& function = F::table->functions[k];
        const std::string file = folder + "/" + function.name + ".known";
        if (!std::filesystem::exists(file)) continue;
        auto& record = F::records[k];
        const std::vector<char> bytes = read_bytes(file);
        const size_t width = size_t(function.columns_in + function.columns_out);
        const Real* row = reinterpret_cast<const Real*>(bytes.data());
        for (size_t left = bytes.size() / (width * sizeof(Real)); left > 0; --left, row += width) {
            std::vector<float> key(row, row + function.columns_in);
            for (float& value : key) value += 0.0f;
            record.known.try_emplace(std::move(key), row + function.columns_in, row + width);
        }
    }
    library.follow<Real>(F::answer);
}

/// FOLDER/FUNCTION.missing: the float32 arguments of the calls that no record answered, each once, in the order of the calls.
template <class Real>
void write_missing(const std::string& folder) {
    for (const auto& [index, record] : Followed<Real>::records) {
        const plugin::Function<Real>& function = Followed<Real>::table->functions[index];
        std::vector<float> rows(record.missing.size() * size_t(function.columns_in));
        for (const auto& [arguments, place] : record.missing)
            std::copy(arguments.begin(), arguments.end(), rows.begin() + place * function.columns_in);
        const std::string file = folder + "/" + function.name + ".missing";
        std::ofstream out(file, std::ios::binary);
        out.write(reinterpret_cast<const char*>(rows.data()), std::streamsize(rows.size() * sizeof(float)));
        out.close();
        if (!out) throw InfrastructureError(file + ": cannot be written");
    }
}

}  // namespace shadelab
