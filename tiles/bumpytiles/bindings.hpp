// How Python calls the loops: arrays come as `Array`, records as structs whose fields are looked up by name in a
// dictionary or any other object, which may have more of them, in any order.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "arrays.hpp"

namespace nb = nanobind;

// Binds `function` under its own name. The interpreter is free to run other threads meanwhile.
#define BUMPY_LOOP(module, function) (module).def(#function, &(function), bumpy::free_interpreter())
// The same for all loops of a source: BUMPY_LOOPS(search, search_ways, connect). To be written outside of all
// namespaces.
#define BUMPY_LOOPS(source, ...)                      \
    void bind_##source(nb::module_& module) {         \
        using namespace bumpy;                        \
        BUMPY_EACH(BUMPY_LOOP_OF_MODULE, __VA_ARGS__) \
    }
#define BUMPY_LOOP_OF_MODULE(function) BUMPY_LOOP(module, function);

// Makes a struct of arrays and numbers a parameter of bound functions: BUMPY_RECORD(Cells, row, col, height). To be
// written outside of all namespaces.
#define BUMPY_RECORD(Struct, ...)                                                              \
    template <>                                                                                \
    struct nanobind::detail::type_caster<Struct> {                                             \
        NB_TYPE_CASTER(Struct, const_name("object"))                                           \
        bool from_python(handle source, std::uint32_t flags, cleanup_list* cleanup) noexcept { \
            return BUMPY_EACH(BUMPY_FIELD, __VA_ARGS__) true;                                  \
        }                                                                                      \
    };
#define BUMPY_FIELD(name) bumpy::read_field(source, #name, value.name, flags, cleanup) &&
#define BUMPY_EACH(macro, ...) __VA_OPT__(BUMPY_EXPAND(BUMPY_EACH_NEXT(macro, __VA_ARGS__)))
#define BUMPY_EACH_NEXT(macro, first, ...) macro(first) __VA_OPT__(BUMPY_EACH_AGAIN BUMPY_PARENS(macro, __VA_ARGS__))
#define BUMPY_EACH_AGAIN() BUMPY_EACH_NEXT
#define BUMPY_PARENS ()
#define BUMPY_EXPAND(...) BUMPY_EXPAND4(BUMPY_EXPAND4(BUMPY_EXPAND4(__VA_ARGS__)))
#define BUMPY_EXPAND4(...) BUMPY_EXPAND2(BUMPY_EXPAND2(BUMPY_EXPAND2(__VA_ARGS__)))
#define BUMPY_EXPAND2(...) BUMPY_EXPAND1(BUMPY_EXPAND1(BUMPY_EXPAND1(__VA_ARGS__)))
#define BUMPY_EXPAND1(...) __VA_ARGS__

namespace bumpy {

using free_interpreter = nb::call_guard<nb::gil_scoped_release>;

// A value that Python gives, as C++ has it; false where it does not fit. Numbers of numpy are taken as numbers.
template <class T>
bool read_value(nb::handle source, T& value, std::uint32_t flags, nb::detail::cleanup_list* cleanup) noexcept {
    nb::detail::make_caster<T> caster;
    if (!caster.from_python(source, flags, cleanup) || !caster.template can_cast<T>()) return false;
    value = caster.operator nb::detail::cast_t<T>();
    return true;
}

template <class T>
bool read_field(
    nb::handle source, const char* name, T& value, std::uint32_t flags, nb::detail::cleanup_list* cleanup) noexcept {
    const bool is_dict = nb::isinstance<nb::dict>(source);
    nb::object field = is_dict ? nb::borrow(PyDict_GetItemString(source.ptr(), name))
                               : nb::steal(PyObject_GetAttrString(source.ptr(), name));
    if (!field.is_valid()) {
        PyErr_Clear();
        return false;
    }
    if (!read_value(field, value, flags, cleanup)) return false;
    cleanup->append(field.release().ptr());  // a property may have made it for this call alone
    return true;
}

}  // namespace bumpy

template <class T, int Axes>
struct nanobind::detail::type_caster<bumpy::Array<T, Axes>> {
    using Given = ndarray<numpy, T, nanobind::ndim<Axes>, c_contig, device::cpu>;
    using Value = bumpy::Array<T, Axes>;
    static constexpr auto Name = make_caster<Given>::Name;
    template <class>
    using Cast = Value;
    template <class>
    static constexpr bool can_cast() {
        return true;
    }

    bool from_python(handle source, std::uint32_t flags, cleanup_list* cleanup) noexcept {
        const auto no_copy = flags & ~static_cast<std::uint32_t>(cast_flags::convert);
        if (!caster.from_python(source, no_copy, cleanup)) return false;
        const Given& given = caster.value;
        value.data = given.data();
        for (std::size_t axis = 0; axis < Axes; ++axis)
            value.shape[axis] = static_cast<bumpy::Index>(given.shape(axis));
        return true;
    }

    explicit operator Value() { return value; }

    make_caster<Given> caster;
    Value value;
};
